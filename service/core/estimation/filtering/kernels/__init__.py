"""Arithmetic of the attitude filter, as numpy runs it or compiled.

Public: anchor_kernels, kernels, state_kernels.
"""
