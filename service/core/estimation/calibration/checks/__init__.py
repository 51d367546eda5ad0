"""Checks of a calibration: axes of the sensors, places of the stations."""
