"""Torque command of a row: law, allocation, inhibitions, schedule check.

Public: command_record, compute_command, control_design, control_inhibitions, schedule_check.
"""
