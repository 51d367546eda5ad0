"""Results (L2-L5): attitude, commands, calibrations, jobs."""
