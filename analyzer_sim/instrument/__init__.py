"""One spectrum analyzer: settings, sweep, spectrum, detectors, its errors, channel power.

Public: channel_power, imperfections, instrument, instrument_settings, levels, models, painter, quantities, spectrum,
sweep_progress, trace_faults, truth_log.
"""
