"""Stages of the chain, one a file: level in, level out; chain.py writes their order once."""
