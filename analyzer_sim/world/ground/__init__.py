"""Ground: what the operators of a simulated satellite know and send."""
