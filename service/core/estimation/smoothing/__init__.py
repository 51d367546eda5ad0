"""Smoothing: states of past rows after the rows that came later.

Public: adjoint, effective_row, row_capture.
"""
