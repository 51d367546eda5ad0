"""Closed loops: the product in process against the plant, its spacecraft in a process of its own."""
