"""Attitude control law and wheel allocation."""
