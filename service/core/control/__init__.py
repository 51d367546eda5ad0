"""Attitude control law and wheel allocation.

Public: command_plan, envelope, gyro_orbitant, gyro_orbitant_design, pulses, quaternion_law, sign_check,
sign_profiles, slew_schedule, wheel_allocation, wheels.
"""
