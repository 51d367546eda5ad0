"""Antennas of the satellite as the powers show them: boresight against the body, daily change, beams of the stations.

Public: boresight, boresight_wave, station_beams.
"""
