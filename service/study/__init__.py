"""Studies: demonstrations and campaigns on simulated truth.

Public: executors, published.
"""
