"""Angles of a sensor at the rows of a calibration: between readings, and none beyond their reach on either side."""

import numpy as np
import pytest

from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.sensor_angles import angles_at
from service.records.levels.series import ReferenceSeries

CONFIG = CalibrationConfig()
REACH_S = CONFIG.reference_reach_s
#: readings with a gap of ten reaches after the third
AT_S = np.array([0.0, REACH_S, 2.0 * REACH_S, 12.0 * REACH_S])


def angle_deg(seconds):
    """Return pitch at some rows, read by a sensor that says a degree a reach."""
    epochs_us = np.round(AT_S * 1e6).astype(np.int64)
    series = ReferenceSeries("gyro", epochs_us, np.tile(AT_S / REACH_S, (3, 1)).T, np.full((4, 3), 0.01))
    rows_us = np.round(np.asarray(seconds) * 1e6).astype(np.int64)
    return angles_at(rows_us, (series,), ("none", "none", "gyro"), CONFIG)


def test_a_row_between_readings_and_within_reach_of_either_has_an_angle():
    at_s = REACH_S * np.array([0.5, 1.9, 2.9, 11.1])
    assert angle_deg(at_s)[:, 2] == pytest.approx([0.5, 1.9, 2.9, 11.1])


def test_beyond_the_reach_of_both_neighbours_there_is_none():
    assert np.isnan(angle_deg(REACH_S * np.array([3.1, 7.0, 10.9]))[:, 2]).all()


def test_a_sensor_without_readings_has_no_angle():
    assert np.isnan(angle_deg([0.0, REACH_S])[:, :2]).all()
