"""Orbit of the satellite from two-line elements or an OEM.

Public: oem, orbit, tle.
"""
