"""Results (L2-L5): attitude, commands, calibrations, jobs.

Public: result_segments, results, stored_rows.
"""
