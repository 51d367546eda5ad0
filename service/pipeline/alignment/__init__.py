"""Alignment: references of both methods from a window with attitude sensors."""
