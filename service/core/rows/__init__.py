"""Figures of stretches of rows: samples of equal intervals, gaps.

Public: row_gaps, sample_bins.
"""
