"""Checkpoints: the state of a chain as bytes, from which another chain goes on bit for bit."""
