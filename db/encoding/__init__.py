"""Encoding of rows: packed powers, sealed segments, JSON documents."""
