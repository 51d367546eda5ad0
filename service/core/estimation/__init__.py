"""Harmonic, octants, sensitivity, snapshot fix, observability.

Public: calibration_turns, carrier_sets, design, momentum_bound, noise_identification, noise_model, observability.
"""
