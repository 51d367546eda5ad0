"""Results (L2-L5): attitude, commands, calibrations, jobs.

Public: attitude_reader, attitude_summaries, carrier_summaries, result_segments, results, state_summaries,
stored_rows.
"""
