"""Live supervisor, replay, jobs, live feed and the only readers of time.

Public: clock, log_format, process_metrics.
"""
