"""Settings of the analyzer: limits, couplings and the makers' models.

Public: analyzer_model, instrument_settings, models, quantities.
"""
