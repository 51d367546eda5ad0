"""Demonstration: real processes over a simulated satellite, judged against its truth.

Public: closed_judgement, control_centre, demonstration, figures, judgement, merit, processes, replay_check,
spacecraft_line, two_step_centre.
"""
