"""Data levels L0-L5, catalogue and calibration: frozen slotted dataclasses."""
