"""Flight of the chain over one simulated world of the estimation study.

Public: baselines, catalogue_lines, drive, episodes, past, world.
"""
