"""Published method: harmonic removal, snapshot fix, rate filter.

Public: harmonic_removal, runner, snapshot_fix.
"""
