"""Simulated world: spacecraft, orbit, beams, carriers, weather, scenarios, and the ground that measures.

Public: motion_statistics, polarimeter, scenario_table, sensors, world.
"""
