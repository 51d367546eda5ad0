"""Carrier model: arrays of a calibration, expected levels, level control.

Public: calibrated_arrays, expected_level, level_control.
"""
