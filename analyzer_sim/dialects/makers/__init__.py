"""Command tables of the four makers.

Public: anritsu, keysight, rs, siglent.
"""
