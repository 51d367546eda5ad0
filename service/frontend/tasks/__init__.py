"""Checks and plans of measurement tasks, zoom sweeps, station files.

Public: station_file, task_plan, zoom_plan.
"""
