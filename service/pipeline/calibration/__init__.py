"""Calibration of both methods from quiet days and turns.

Public: geometry_calibration, minute_rows, paper_calibration, window_harmonics, windows.
"""
