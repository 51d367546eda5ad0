"""Scenarios as data: phases, events, and the catalogue of scenarios."""
