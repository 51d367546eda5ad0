"""Alarms: conditions on rows, states after ISA-18.2, limit sets."""
