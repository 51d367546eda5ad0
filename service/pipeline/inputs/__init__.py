"""Inputs beside powers: known motion, declared operations, sensor angles, weather reports, polarimeters.

Public: catalogue_checks, catalogue_torque, declared_operations, documents, knowledge, known_motion, polarization,
reference_angles, sensor_angles, telemetry_rates, weather_reports.
"""
