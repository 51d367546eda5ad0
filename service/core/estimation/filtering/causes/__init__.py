"""Causes of a changed level: one carrier, a transponder, rain, the receiving chain."""
