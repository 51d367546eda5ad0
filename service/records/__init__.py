"""Data levels L0-L5, catalogue and calibration: frozen slotted dataclasses.

NaN in a record means not known, and is not equal to itself: records that may hold it are not compared as a whole.
"""
