"""Spacecraft: attitude, body, wheels, on-board loop, telemetry and uplink.

Public: angles_loop, body_dynamics, disturbance, flown_spacecraft, hub_tones, operator, rigid_body, spacecraft,
stored_momentum, telemetry, uplink, wheels.
"""
