"""Expected periodograms are the mean of many, whatever the gaps; groups cover what they should."""

import numpy as np
import pytest
from scipy.signal import lfilter

from service.core.estimation.noise.periodogram import grouped_spectra, regular_grid


def test_rows_find_their_places_on_the_grid():
    grid = regular_grid(np.array([0.0, 59.8, 120.3, 300.0, 300.1]))
    assert grid.position.tolist() == [0, 1, 2, 5]
    assert grid.row.tolist() == [0, 1, 2, 3]
    assert grid.length == 6


def test_a_finer_cadence_is_thinned():
    grid = regular_grid(np.arange(200_000.0))
    assert grid.length <= 60_001
    assert grid.step_s == pytest.approx(200_000 / 60_000, rel=0.01)


@pytest.mark.parametrize("has_gaps", [False, True])
def test_expectation_is_the_mean_of_many(has_gaps):
    rows, series, tau_s = 1440, 400, np.array([1200.0, 20_000.0])
    rng = np.random.default_rng(11)
    values = []
    for tau in tau_s:
        keep = np.exp(-60.0 / tau)
        shocks = np.sqrt(1.0 - keep**2) * rng.normal(size=(rows, series))
        shocks[0] /= np.sqrt(1.0 - keep**2)
        values.append(lfilter([1.0], [1.0, -keep], shocks, axis=0))
    values.append(rng.normal(size=(rows, series)))
    grid = regular_grid(np.arange(rows) * 60.0)
    for position, one in enumerate(values):
        if has_gaps:
            one[300:500] = np.nan
        spectra = grouped_spectra(one, grid, tau_s, 100)
        ratio = spectra.power.mean(axis=0) / spectra.expected[0, (position + 1) % 3]
        # 400 series: one sigma 5 % of a single frequency; taking the mean away costs what leaks out of zero
        assert ratio[1:] == pytest.approx(np.ones(len(ratio) - 1), abs=0.25)
        # with a gap a part of the mean leaks to all frequencies, and is gone with the mean
        assert np.mean(ratio[5:]) == pytest.approx(1.0, abs=0.08 if has_gaps else 0.04)


def test_once_and_twice_a_day_take_no_part():
    rows = 4320
    wave = np.cos(2.0 * np.pi * np.arange(rows) / 1440.0)[:, np.newaxis]
    spectra = grouped_spectra(
        wave + np.cos(2.0 * np.pi * np.arange(rows) / 720.0)[:, np.newaxis],
        regular_grid(np.arange(rows) * 60.0),
        np.array([1200.0]),
        100,
    )
    # two whole waves over a whole number of days are two frequencies
    assert spectra.power.max() < 1e-12
    assert spectra.weight.sum() == rows // 2 - 2


def test_a_series_of_few_rows_weighs_nothing():
    values = np.full((500, 2), 0.1)
    values[50:, 0] = np.nan
    spectra = grouped_spectra(values, regular_grid(np.arange(500) * 60.0), np.array([300.0]), 100)
    assert not spectra.weight[0].any()
    assert spectra.weight[1].all()
