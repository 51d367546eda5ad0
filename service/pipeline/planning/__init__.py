"""Planning before a calibration: sets of carriers, turns, assumed beams, and a rehearsal over quiet days."""
