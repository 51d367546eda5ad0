"""Calibration of both methods from quiet days and turns."""
