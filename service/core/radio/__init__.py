"""Decibels, carrier power from a trace, presence, predicted sigma."""
