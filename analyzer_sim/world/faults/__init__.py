"""Faults and weather: what the events of a scenario do to levels."""
