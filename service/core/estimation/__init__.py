"""Harmonic, octants, sensitivity, snapshot fix, observability.

Public: calibration_turns, carrier_sets, design, noise_identification, noise_model, observability.
"""
