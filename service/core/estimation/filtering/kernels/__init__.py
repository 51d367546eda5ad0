"""Kernels of the attitude filter: compiled loops, and the same in arrays.

Public: kernels.
"""
