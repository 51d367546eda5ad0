"""Orbit of the satellite and directions seen from it."""
