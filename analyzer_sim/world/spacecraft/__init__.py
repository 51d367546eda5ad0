"""Spacecraft: attitude, body, wheels, on-board loop, telemetry and uplink."""
