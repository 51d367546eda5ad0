"""Noise of the carriers' levels, identified from quiet days."""
