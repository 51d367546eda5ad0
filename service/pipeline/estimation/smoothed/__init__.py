"""Smoothed angles: the robust method's rows after the rows that came later."""
