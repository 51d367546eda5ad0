"""Decibels, carrier power from a trace, presence, predicted sigma.

Public: band_weights, carrier_power, decibel, leakage, predicted_sigma, presence.
"""
