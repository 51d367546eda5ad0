"""Watches of the attitude filter: tests of its assumptions that run beside it.

Public: command_watch, drift_watch, integrity, minute_sums, momentum_watch, motion_watch,
noise_watch, polarimeter_watch, rate_watch.
"""
