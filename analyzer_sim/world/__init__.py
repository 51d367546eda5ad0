"""Simulated world: spacecraft, orbit, beams, carriers, weather, scenarios, and the ground that measures."""
