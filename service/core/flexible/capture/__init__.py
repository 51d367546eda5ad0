"""Capture: from which rates one axis comes to rest.

Public: capture, capture_analysis.
"""
