"""Relay-pulse wheel control of a flexible spacecraft: limit cycles, elastic capture, check of torque schedules.

Public: both_lines, closed_forms, limit_cycle, motion, phi_functions, propagation, return_kernels, spacecraft,
succession, switching_law.
"""
