"""Carrier model: arrays of a calibration, expected levels, level control."""
