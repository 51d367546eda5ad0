"""The published method: harmonics, sensitivities by sign, octants, the fade rule.

Public: consistency, criteria, downlink_fade, harmonic, octants, rejection, selection, sensitivity, trailing_mean.
"""
