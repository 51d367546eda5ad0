"""Command tables of the four makers."""
