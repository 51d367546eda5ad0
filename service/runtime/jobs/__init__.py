"""Long work: calibrations, alignments, replays, analyses, archive maintenance.

Public: alignment_service, archive_analysis, archive_maintenance, beam_analysis, calibration_job, flight_analysis_job,
job_runner, lagged_run, lagged_series, replay_job, replay_run, workers.
"""
