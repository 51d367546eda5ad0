"""Capture: from which rates one axis comes to rest."""
