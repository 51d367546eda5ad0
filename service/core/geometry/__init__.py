"""Frames, Earth and stations, node phase."""
