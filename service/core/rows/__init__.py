"""Figures of stretches of rows: samples of equal intervals, summaries of buckets, gaps, runs of states."""
