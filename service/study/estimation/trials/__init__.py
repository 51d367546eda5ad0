"""Trials of single steps of the method: snapshots, levels."""
