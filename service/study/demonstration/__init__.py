"""Demonstration: real processes over a simulated satellite, judged against its truth."""
