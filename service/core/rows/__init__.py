"""Figures of stretches of rows: samples of equal intervals, summaries of buckets, gaps, runs of states.

Public: row_gaps, sample_bins, state_runs, summaries.
"""
