"""Kernels of the attitude filter: compiled loops, and the same in arrays.

Public: anchor_kernels, array_kernels, kernels, loop_kernels.
"""
