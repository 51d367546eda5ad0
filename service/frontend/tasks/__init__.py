"""Checks and plans of measurement tasks, zoom sweeps, station files."""
