"""Angles of an alignment: a straight line through each axis's own sensor, read at the newest reference."""

import numpy as np
import pytest

from service.pipeline.inputs.reference_angles import StatedAngles, smooth_angles, stated_sigma_deg
from service.records.levels.attitude import Axes
from service.records.levels.series import ReferenceSeries

S = 1_000_000
START_US = 1_800_000_000 * S
NAN = float("nan")


def series(source, epochs_us, angles, sigma=0.02):
    epochs = np.asarray(epochs_us, dtype=np.int64)
    reported = np.broadcast_to(np.asarray(angles, dtype=np.float64), (len(epochs), 3)).copy()
    return ReferenceSeries(source, epochs, reported, np.full((len(epochs), 3), sigma))


def test_a_line_is_read_at_the_newest_reference_with_its_sigma_and_slope():
    epochs_us = START_US + 60 * S * np.arange(31)
    minutes = np.arange(31.0)
    slopes = np.array([0.001, -0.002, 0.003])
    stated, missing = smooth_angles((series("st", epochs_us, minutes[:, None] * slopes),), ("st",) * 3)
    assert missing == ()
    assert stated.epoch_us == epochs_us[-1]
    # a straight line is found to rounding
    np.testing.assert_allclose(stated.attitude_deg, 30.0 * slopes, atol=1e-12)
    np.testing.assert_allclose(stated.rate_deg_s, slopes / 60.0, atol=1e-15)
    # the end of a line of n equal steps: variance (4 n + 2) / ((n + 1) (n + 2)) of one reading, n = 30 steps
    wanted = 0.02 * np.sqrt((4 * 30 + 2) / (31 * 32))
    np.testing.assert_allclose(stated.sigma_deg, wanted, rtol=1e-9)


def test_each_axis_has_its_own_sensor_and_all_are_read_at_one_epoch():
    beacon = series("beacon", START_US + 60 * S * np.arange(20), [0.3, NAN, NAN])
    earth = series("earth", START_US + 60 * S * np.arange(40), [NAN, 0.1, -0.2], sigma=NAN)
    stated, missing = smooth_angles((earth, beacon), ("beacon", "earth", "earth"))
    assert (missing, stated.epoch_us) == ((), START_US + 39 * 60 * S)
    np.testing.assert_allclose(stated.attitude_deg, [0.3, 0.1, -0.2], atol=1e-12)
    # read 20 minutes after its last reading a line is less certain; a sensor that states no sigma has 0.05
    assert stated.sigma_deg.yaw > 0.02
    assert stated.sigma_deg.roll == pytest.approx(0.05 * np.sqrt((4 * 39 + 2) / (40 * 41)), rel=1e-9)


def test_axes_that_nobody_saw_are_named():
    blind = series("earth", START_US + S * np.arange(9), [NAN, 0.1, NAN])
    stated, missing = smooth_angles((blind,), ("beacon", "earth", "earth"))
    assert stated is None
    assert missing == ("yaw", "pitch")
    assert smooth_angles((), ("a", "b", "c")) == (None, ("yaw", "roll", "pitch"))


@pytest.mark.parametrize(
    "epochs_us",
    [START_US + 60 * S * np.arange(7), np.full(9, START_US)],
    ids=["too few for a line", "all of one instant"],
)
def test_without_a_line_the_mean_is_taken(epochs_us):
    angles = np.linspace(0.0, 0.6, len(epochs_us))[:, None] * np.ones(3)
    stated, _ = smooth_angles((series("st", epochs_us, angles),), ("st",) * 3)
    np.testing.assert_allclose(stated.attitude_deg, 0.3, atol=1e-12)
    np.testing.assert_allclose(stated.sigma_deg, 0.02 / np.sqrt(len(epochs_us)), rtol=1e-12)
    assert stated.rate_deg_s == Axes(0.0, 0.0, 0.0)


def test_a_sigma_that_is_not_stated_is_the_usual_one():
    reported = stated_sigma_deg(StatedAngles(START_US, Axes(0, 0, 0), Axes(NAN, 0.01, NAN)))
    np.testing.assert_array_equal(reported, [0.05, 0.01, 0.05])
