"""Data levels L0-L5, catalogue and calibration: frozen slotted dataclasses.

Public: calibration, catalogue, csv_guard, epoch, field_faults, geometry, inputs, journal, noise, record_fields,
setting, units.
"""
