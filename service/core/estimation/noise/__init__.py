"""Noise of the carriers' levels, identified from quiet days.

Public: components, periodogram, quantisation.
"""
