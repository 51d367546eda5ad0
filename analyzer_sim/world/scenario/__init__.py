"""Scenarios as data: phases, events, and the catalogue of scenarios.

Public: events, manoeuvres, scenario, story, turns.
"""
