"""Smoothing: states of past rows after the rows that came later."""
