"""Frames, Earth and stations, node phase.

Public: frames, line_of_sight, node_phase, quaternion.
"""
