"""Planning before a calibration: sets of carriers, turns, assumed beams.

Public: assumed_beams, candidates, planning.
"""
