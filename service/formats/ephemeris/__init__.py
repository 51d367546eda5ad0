"""Orbit of the satellite from two-line elements or an OEM."""
