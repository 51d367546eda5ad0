"""Demonstration: real processes over a simulated satellite, judged against its truth.

Public: closed_judgement, demonstration, figures, judgement, merit, processes, replay_check, spacecraft_line.
"""
