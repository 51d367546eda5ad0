"""Gain of smoothed angles is taken on the rows that both answer, pooled over seeds."""

import numpy as np
import pytest

from service.study.estimation.accuracy import AXES
from service.study.estimation.flight.past import PastSeries
from service.study.estimation.smoothing_gain import gain_statistics, measure_gain


@pytest.fixture
def gained(toured_world, driven_world, said):
    """Measure a filter that is off by a known error, and a smoother that is off by another, on every fifth row."""

    def make(filter_error, smoothed_error, sigma_deg=0.01):
        truth = toured_world.truth.attitude_deg
        rows = np.arange(0, len(truth), 5)
        past = PastSeries(
            toured_world.ground.epochs_us[rows],
            truth[rows] + smoothed_error,
            np.full((len(rows), 3), sigma_deg),
        )
        return measure_gain(toured_world, driven_world({}), said(truth + filter_error), past)

    return make


def test_figures_are_ratios_of_what_was_put_in(gained):
    found = gain_statistics("smoothed", [gained(0.02, 0.01)])
    for axis in AXES:
        assert found[f"smoothed.rms_deg.{axis}"] == pytest.approx(0.01, rel=1e-9)
        assert found[f"smoothed.over_filter.{axis}"] == pytest.approx(0.5, rel=1e-9)
        assert found[f"smoothed.over_sigma.{axis}"] == pytest.approx(1.0, rel=1e-9)
    # nothing happened in this world
    assert not any("event" in name or "dark" in name for name in found)


def test_seeds_are_pooled_by_squares(gained):
    found = gain_statistics("smoothed", [gained(0.02, 0.02), gained(0.04, 0.0)])
    expected = np.sqrt(0.02**2 / (0.02**2 + 0.04**2))
    assert found["smoothed.over_filter.roll"] == pytest.approx(expected, rel=1e-9)


def test_large_errors_count_near_events_alone(gained, toured_world):
    toured_world.truth.flags[1500:, 1] = 4
    found = gain_statistics("smoothed", [gained(0.001, 0.05)])
    assert found["smoothed.large_near_events.yaw"] == 1.0
    assert found["smoothed.filter_large_near_events.yaw"] == 0.0


def test_rows_without_carriers_give_the_largest_error(gained, toured_world):
    toured_world.truth.flags[1000:1200] = 2
    found = gain_statistics("smoothed", [gained(0.02, -0.03)])
    assert found["smoothed.dark_deg.pitch"] == pytest.approx(0.03, rel=1e-9)
    assert found["smoothed.filter_dark_deg.pitch"] == pytest.approx(0.02, rel=1e-9)


def test_no_row_no_figure(gained, toured_world):
    assert gain_statistics("smoothed", []) == {}
