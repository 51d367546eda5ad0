"""Antennas of the satellite as the powers show them: boresight against the body, daily change, beams of stations."""
