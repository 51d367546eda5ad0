"""Carrier powers from synthetic traces of known truth."""

import math

import numpy as np
import pytest

from service.core.radio.band_weights import CarrierBands, TraceGrid, band_fractions, span_hz, swept_dof, weigh_bands
from service.core.radio.carrier_power import hide_absent, measure_carriers
from service.core.radio.decibel import mw_from_dbm
from service.core.radio.predicted_sigma import GAUSSIAN_ENBW_RATIO

RBW_HZ = 30e3
N0_DBM_HZ = -120.0


def raised_cosine(offset_hz: np.ndarray, symbol_rate_hz: float, rolloff: float) -> np.ndarray:
    """Return the normalised density of a raised-cosine carrier, 1/Hz."""
    x = np.abs(offset_hz) / symbol_rate_hz
    low, high = (1 - rolloff) / 2, (1 + rolloff) / 2
    slope = 0.5 * (1 + np.cos(np.pi * (np.clip(x, low, high) - low) / rolloff))
    return np.where(x <= high, slope, 0.0) / symbol_rate_hz


def trace(grid: TraceGrid, carriers: list[tuple[float, float, float]], rbw_hz: float = RBW_HZ) -> np.ndarray:
    """Return the mean trace of (centre Hz, symbol rate Hz or 0 for a line, dBm) over the floor, by fine integration."""
    fine_hz = grid.step_hz / 16
    edges = 16 * 12
    axis = grid.start_hz + fine_hz * (np.arange(grid.points * 16 + 2 * edges) - edges - 7.5)
    density = np.full(axis.size, float(mw_from_dbm(N0_DBM_HZ)))
    for centre, symbol_rate, level_dbm in carriers:
        if symbol_rate == 0.0:
            density[int(np.argmin(np.abs(axis - centre)))] += float(mw_from_dbm(level_dbm)) / fine_hz
        else:
            density += float(mw_from_dbm(level_dbm)) * raised_cosine(axis - centre, symbol_rate, 0.25)
    reach = np.arange(-edges, edges + 1) * fine_hz
    shape = np.exp2(-np.square(2 * reach / rbw_hz)) * fine_hz
    behind = np.convolve(density, shape, mode="same")
    inner: np.ndarray = behind[edges:-edges].reshape(grid.points, 16).mean(axis=1)
    return inner


def bands(*rows: tuple[float, float, float]) -> CarrierBands:
    """Return bands of (centre, symbol rate or 0, integration bandwidth) with noise windows at both ends."""
    windows = ((950.2e6, 951.0e6), (989.0e6, 989.8e6))
    rate = np.array([r[1] for r in rows])
    return CarrierBands(
        np.array([r[0] for r in rows]),
        np.array([r[2] for r in rows]),
        np.where(rate == 0, RBW_HZ, rate),
        rate == 0,
        tuple(windows for _ in rows),
    )


GRID = TraceGrid(950e6, 40e6 / 4000, 4001, RBW_HZ * GAUSSIAN_ENBW_RATIO, 2.0)


@pytest.mark.parametrize("level_dbm", [-40.0, -55.0])
@pytest.mark.parametrize("symbol_rate_hz", [1.0e6, 4.5e6, 9.0e6])
def test_mean_trace_gives_the_true_power(symbol_rate_hz: float, level_dbm: float) -> None:
    weights = weigh_bands(GRID, bands((970.003e6, symbol_rate_hz, 1.25 * symbol_rate_hz)))
    power = measure_carriers(trace(GRID, [(970.003e6, symbol_rate_hz, level_dbm)]), weights)
    # 0.03 dB: the bias claimed in the docstring
    assert power.power_dbm[0] == pytest.approx(level_dbm, abs=0.03)
    # 0.05 dB: the windows lie 18 MHz away from the carrier, only rounding of the shape remains
    assert power.n0_dbm_hz[0] == pytest.approx(N0_DBM_HZ, abs=0.05)
    assert power.c_n0_db_hz[0] == pytest.approx(level_dbm - N0_DBM_HZ, abs=0.08)  # sum of the two above
    # 100 Hz: a tenth of a bucket times the edge effects
    assert power.centroid_hz[0] == pytest.approx(970.003e6, abs=1e-3 * symbol_rate_hz)


def test_a_neighbour_six_db_stronger_does_not_bias_the_level() -> None:
    carriers = [(968.0e6, 1.0e6, -48.0), (969.31e6, 1.0e6, -42.0)]
    weights = weigh_bands(GRID, bands((968.0e6, 1.0e6, 1.25e6)))
    power = measure_carriers(trace(GRID, carriers), weights)
    assert power.power_dbm[0] == pytest.approx(-48.0, abs=0.03)  # the docstring's claim


def test_a_line_has_its_power_and_no_scatter_of_its_own() -> None:
    weights = weigh_bands(GRID, bands((960.0e6, 0.0, 300e3)))
    power = measure_carriers(trace(GRID, [(960.0e6, 0.0, -60.0)]), weights)
    assert power.power_dbm[0] == pytest.approx(-60.0, abs=0.03)  # the docstring's claim
    # 6.14 10^(-CNR/20) / sqrt(ENBW t) with CNR 15 dB and ENBW t = 51; 10%: the noise's own small term
    assert power.sigma_db[0] == pytest.approx(6.14 * 10 ** (-15 / 20) / math.sqrt(51), rel=0.1)


def test_without_subtraction_noise_counts_as_carrier() -> None:
    weights = weigh_bands(GRID, bands((970.0e6, 1.0e6, 1.25e6)))
    level = N0_DBM_HZ + 60.0 + 3.0  # C/N 3 dB in the symbol rate
    power = measure_carriers(trace(GRID, [(970.0e6, 1.0e6, level)]), weights)
    assert power.power_dbm[0] == pytest.approx(level, abs=0.03)
    # 2.1 dB: the figure of the front-end study for C/N 3 dB
    assert power.power_total_dbm[0] - level == pytest.approx(2.1, abs=0.1)
    assert power.c_n_db[0] == pytest.approx(3.0, abs=0.08)


def test_two_hundred_sweeps_are_unbiased_and_scatter_as_predicted() -> None:
    rng = np.random.default_rng(20261121)
    level = N0_DBM_HZ + 60.0 + 10.0
    weights = weigh_bands(GRID, bands((970.0e6, 1.0e6, 1.25e6)))
    mean = trace(GRID, [(970.0e6, 1.0e6, level)])
    dof = float(swept_dof(GRID, np.array([GRID.step_hz]))[0])
    drawn = rng.gamma(dof, 1.0 / dof, size=(400, GRID.points)) * mean
    rows = [measure_carriers(row, weights) for row in drawn]
    levels = np.array([row.power_dbm[0] for row in rows])
    predicted = float(np.mean([row.sigma_db[0] for row in rows]))
    # 0.03 dB bias plus 3 standard errors of the mean
    assert abs(levels.mean() - level) < 0.03 + 3 * predicted / math.sqrt(400)
    # 15%: the study's bound; the standard error of a deviation from 400 draws is 3.5%
    assert levels.std() == pytest.approx(predicted, rel=0.15)


def test_noise_alone_leaves_nothing_or_little_and_ratio_below_threshold() -> None:
    rng = np.random.default_rng(7)
    weights = weigh_bands(GRID, bands((970.0e6, 1.0e6, 1.25e6)))
    mean = trace(GRID, [])
    dof = float(swept_dof(GRID, np.array([GRID.step_hz]))[0])
    for row in rng.gamma(dof, 1.0 / dof, size=(100, GRID.points)) * mean:
        power = measure_carriers(row, weights)
        assert power.presence_ratio_db[0] < power.presence_threshold_db[0]


def test_a_signal_in_one_noise_window_is_left_out_and_flagged() -> None:
    carriers = [(970.0e6, 1.0e6, -50.0), (950.6e6, 0.3e6, -55.0)]
    weights = weigh_bands(GRID, bands((970.0e6, 1.0e6, 1.25e6)))
    power = measure_carriers(trace(GRID, carriers), weights)
    assert bool(power.is_noise_dirty[0])
    assert power.n0_dbm_hz[0] == pytest.approx(N0_DBM_HZ, abs=0.05)  # as from the clean window alone


def test_not_a_number_spoils_only_its_own_carrier() -> None:
    weights = weigh_bands(GRID, bands((960.0e6, 1.0e6, 1.25e6), (970.0e6, 1.0e6, 1.25e6)))
    values = trace(GRID, [(960.0e6, 1.0e6, -45.0), (970.0e6, 1.0e6, -50.0)])
    values[1000] = np.nan  # 960 MHz
    power = measure_carriers(values, weights)
    assert power.is_nonfinite.tolist() == [True, False]
    assert np.isnan(power.power_dbm[0])
    assert power.power_dbm[1] == pytest.approx(-50.0, abs=0.03)  # the docstring's claim


def test_hidden_carriers_keep_their_upper_limit() -> None:
    weights = weigh_bands(GRID, bands((970.0e6, 1.0e6, 1.25e6)))
    power = hide_absent(measure_carriers(trace(GRID, []), weights), np.array([False]))
    assert np.isnan(power.power_dbm[0])
    assert np.isnan(power.sigma_db[0])
    # 10 lg(1.25e6) = 61.0 dB: the noise in the band; 0.05 dB as above
    assert power.power_total_dbm[0] == pytest.approx(N0_DBM_HZ + 60.97, abs=0.05)


def test_bands_outside_the_trace_are_refused() -> None:
    with pytest.raises(ValueError, match="integration band 0 does not lie inside"):
        weigh_bands(GRID, bands((949.9e6, 1.0e6, 1.25e6)))
    without = bands((970.0e6, 1.0e6, 1.25e6))._replace(noise_windows_hz=((),))
    with pytest.raises(ValueError, match="carrier 0 has no noise window"):
        weigh_bands(GRID, without)


def test_fractions_add_up_to_the_width() -> None:
    low, high = np.array([960.1234e6]), np.array([961.9876e6])
    fractions = band_fractions(GRID, low, high)
    # 1e-3 Hz: rounding of frequencies near 1 GHz in float64, 4e3 terms
    assert fractions.sum() * GRID.step_hz == pytest.approx(high[0] - low[0], abs=1e-2)
    assert span_hz(GRID) == pytest.approx(40e6, abs=1e-3)
