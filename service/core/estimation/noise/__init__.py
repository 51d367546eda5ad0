"""Noise of the carriers' levels, identified from quiet days.

Public: allan, components, periodogram, quantisation.
"""
