"""Figures of stretches of rows: samples of equal intervals, summaries of buckets, gaps.

Public: row_gaps, sample_bins, summaries.
"""
