"""Inputs beside powers: known motion, declared operations, sensor angles.

Public: catalogue_checks, catalogue_torque, declared_operations, knowledge, known_motion, reference_angles,
sensor_angles.
"""
