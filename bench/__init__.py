"""Benchmarks: ratios measured in one run, with the figures they come from."""
