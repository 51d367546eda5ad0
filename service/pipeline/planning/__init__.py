"""Planning before a calibration: sets of carriers, turns, assumed beams."""
