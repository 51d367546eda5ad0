"""Simulated spectrum analyzer and the world behind it; shares no code with the service."""
