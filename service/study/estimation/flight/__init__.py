"""Flight of the chain over one simulated world of the estimation study.

Public: catalogue_lines, drive, episodes, oracle, world.
"""
