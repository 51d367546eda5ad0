"""Spectrum analyzer drivers, one dialect a file."""
