"""Figures of stretches of rows: samples of equal intervals, gaps."""
