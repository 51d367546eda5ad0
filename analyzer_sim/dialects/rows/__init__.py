"""Rows of command tables that several makers share."""
