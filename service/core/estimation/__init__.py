"""Harmonic, octants, sensitivity, snapshot fix, observability.

Public: attitude_bound, calibration_turns, carrier_sets, design, noise_identification, noise_model, observability.
"""
