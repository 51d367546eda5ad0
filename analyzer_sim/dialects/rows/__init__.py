"""Rows of command tables that several makers share.

Public: analyzer_rows, command_row, function_rows, ieee488_rows, marker_rows, power_list_rows, settings_rows,
span_rows, sweep_rows, trace_rows.
"""
