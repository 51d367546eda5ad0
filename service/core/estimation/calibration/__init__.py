"""Calibration of all carriers in one fit tied by the geometry of their stations.

Public: calibration_bins, coloured_rows, daily_fit, gathered_torque, geometry_calibration, geometry_columns,
geometry_prediction, level_drift, quadratic_response, sensor_smoothing.
"""
