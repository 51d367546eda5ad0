"""Payload: carriers, beams, transponders and the levels that they give.

Public: carriers, effects, level_terms, payload, plan_versions, user_noise.
"""
