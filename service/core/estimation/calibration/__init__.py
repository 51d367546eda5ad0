"""Calibration of all carriers in one fit tied by the geometry of their stations."""
