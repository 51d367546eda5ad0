"""Smoothed angles: the robust method's rows after the rows that came later.

Public: lagged_rows, smoothed_rows, smoother.
"""
