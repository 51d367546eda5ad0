"""Payload: carriers, beams, transponders and the levels that they give."""
