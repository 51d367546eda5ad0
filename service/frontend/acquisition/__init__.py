"""Rows from sweeps: the state machine that runs one analyzer, its orders, pace and evaluation."""
