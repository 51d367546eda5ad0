"""What is at the input: spacecraft, orbit, beams, carriers, weather, stories, and the ground that watches.

Public: scenario_table, sensors, world.
"""
