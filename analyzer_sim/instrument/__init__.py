"""One spectrum analyzer: settings, sweep, spectrum, detectors, its errors, what it measures on a trace.

Public: imperfections, instrument, levels, painter, spectrum, sweep_progress, trace_faults, truth_log.
"""
