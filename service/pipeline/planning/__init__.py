"""Planning before a calibration: sets of carriers, turns, assumed beams, and a rehearsal over quiet days.

Public: assumed_beams, beam_contours, candidates, flown_turns, momentum_gain, planning, quiet_days,
rehearsal, user_sites.
"""
