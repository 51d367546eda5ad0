"""Carrier model: arrays of a calibration, expected levels, level control, beams.

Public: beam_report, calibrated_arrays, expected_level, level_control.
"""
