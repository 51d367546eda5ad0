"""Attitude of one epoch alone, robust against several wrong carriers.

Public: fault_bounds, snapshot, snapshot_start.
"""
