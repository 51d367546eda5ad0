"""Robust method: attitude filter over all carriers.

Public: attitude_rows, runner, saved_state.
"""
