"""Rows of command tables that several makers share.

Public: analyzer_rows, command_row, ieee488_rows, settings_rows, span_rows, sweep_rows, trace_rows.
"""
