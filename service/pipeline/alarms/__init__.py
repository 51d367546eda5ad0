"""Alarms: conditions on rows, states after ISA-18.2, limit sets.

Public: alarm_engine, condition, conditions, limit_sets, readings.
"""
