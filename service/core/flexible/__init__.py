"""Relay-pulse wheel control of a flexible spacecraft: limit cycles, elastic capture, check of torque schedules."""
