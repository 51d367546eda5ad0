"""Angles of noisy sensors: turns keep their edges, what is quiet is left alone."""

import numpy as np
import pytest

from service.core.estimation.calibration.sensor_smoothing import (
    SEGMENT_PENALTY,
    reading_sigma_deg,
    segment_starts,
    smoothed_angles,
)


def turned(seed, sigma_deg):
    """Return times, truth and readings (T, 3): a quiet day of slow motion and turns of 15 min."""
    rng = np.random.default_rng(seed)
    truth = 0.04 * np.sin(np.arange(1800)[:, None] / np.array([150.0, 120.0, 140.0]))
    for number, size in enumerate((0.25, 0.5, -0.25, -0.5)):
        begin = 1500 + 25 * number
        truth[begin : begin + 15, 1] += size
    return np.arange(1800) * 60.0, truth, truth + sigma_deg * rng.normal(size=truth.shape)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("sigma_deg", [0.03, 0.06, 0.1])
def test_noise_falls_and_edges_stay(seed, sigma_deg):
    epoch_s, truth, reported = turned(seed, sigma_deg)
    smoothed = smoothed_angles(epoch_s, reported)
    error = smoothed.attitude_deg - truth
    quiet = np.sqrt((error[:1400] ** 2).mean(axis=0))
    # pieces of an hour or two: noise of their means and the steps in which slow motion is followed
    assert (quiet < [0.3 * sigma_deg + 0.004] * 3).all()
    assert smoothed.sensor_sigma_deg == pytest.approx(np.full(3, sigma_deg), rel=0.1)
    assert (smoothed.remaining_sigma_deg < 0.35 * sigma_deg).all()
    plateau = error[1525:1540, 1]
    assert abs(plateau.mean()) < sigma_deg  # mean of fifteen readings: a quarter of it, four times that


def test_a_star_tracker_is_left_as_it_is():
    epoch_s, _, reported = turned(1, 0.01)
    assert (smoothed_angles(epoch_s, reported).attitude_deg == reported).all()


def test_axes_without_readings_stay_absent():
    epoch_s, _, reported = turned(1, 0.06)
    reported[:, 0] = np.nan
    reported[100:200, 2] = np.nan
    smoothed = smoothed_angles(epoch_s, reported)
    assert np.isnan(smoothed.attitude_deg[:, 0]).all()
    assert np.isnan(smoothed.sensor_sigma_deg[0])
    assert np.isnan(smoothed.attitude_deg[100:200, 2]).all()
    assert np.isfinite(smoothed.attitude_deg[:, 1]).all()


def test_pieces_are_the_cheapest_of_all():
    """Against every way of cutting nine readings."""
    values = np.array([0.1, -0.3, 0.2, 6.0, 6.4, 5.7, 5.9, -4.0, -4.4])

    def cost(starts):
        chunks = np.split(values, starts[1:])
        return sum(((chunk - chunk.mean()) ** 2).sum() for chunk in chunks) + SEGMENT_PENALTY * len(chunks)

    ways = [[0, *(k + 1 for k in range(8) if number >> k & 1)] for number in range(256)]
    best = min(ways, key=cost)
    assert segment_starts(np.arange(9) * 60.0, values).tolist() == best == [0, 3, 7]


def test_no_piece_is_longer_than_two_hours():
    starts = segment_starts(np.arange(400) * 60.0, np.zeros(400))
    assert np.diff([*starts, 400]).max() <= 120
    sparse = segment_starts(np.arange(100) * 600.0, np.zeros(100))
    assert np.diff([*sparse, 100]).max() <= 13


def test_few_readings_have_no_noise():
    assert np.isnan(reading_sigma_deg(np.array([0.1, np.nan, 0.2])))
    assert np.isnan(smoothed_angles(np.zeros(0), np.zeros((0, 3))).sensor_sigma_deg).all()
