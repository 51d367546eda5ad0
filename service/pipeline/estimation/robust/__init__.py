"""Robust method: attitude filter over all carriers.

Public: attitude_rows, row_recorder, runner, saved_state.
"""
