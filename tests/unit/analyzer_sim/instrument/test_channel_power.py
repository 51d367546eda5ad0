"""Power of a channel of a trace, against sums written out."""

import math

import numpy as np
import pytest

from analyzer_sim.emission import Emission, Signal
from analyzer_sim.instrument.channel_power import (
    Band,
    band_power_mw,
    bin_shares,
    decibels,
)
from analyzer_sim.instrument.spectrum import SweepGrid, mean_trace

GRID = SweepGrid(954e6, 990e6, 2401, 30e3)
#: 3 dB width of 30 kHz, noise bandwidth of a Gaussian
ENBW_HZ = 30e3 * math.sqrt(math.pi / (4 * math.log(2)))


def trace_dbm(*signals: Signal, noise_dbm_hz: float = -400.0) -> np.ndarray:
    return 10 * np.log10(mean_trace(Emission(0, signals, noise_dbm_hz), GRID, -400.0).total_mw)


FLAT_DBM = np.full(2401, -100.0 + 10 * math.log10(ENBW_HZ))


@pytest.mark.parametrize("width_hz", [15e3, 1e6, 1.2345e6, 36.015e6])
@pytest.mark.parametrize("shift_hz", [0.0, 3.7e3])
def test_flat_noise_gives_density_times_width_whatever_the_edges(width_hz: float, shift_hz: float) -> None:
    shift_hz = 0.0 if width_hz > 36e6 else shift_hz
    power_mw = band_power_mw(FLAT_DBM, GRID, Band(972e6 + shift_hz, width_hz))
    assert 10 * math.log10(power_mw) == pytest.approx(-100.0 + 10 * math.log10(width_hz), abs=1e-9)


@pytest.mark.parametrize("rate_hz", [0.25e6, 1e6, 9e6])
def test_carrier_gives_its_power_and_a_line_too(rate_hz: float) -> None:
    carrier = Signal("x", 971.3e6, rate_hz, 0.25, -43.0)
    line = Signal("y", 985e6, 0.0, 0.0, -40.0)
    levels_dbm = trace_dbm(carrier, line)
    width_hz = 1.25 * rate_hz + 200e3
    assert decibels(band_power_mw(levels_dbm, GRID, Band(971.3e6, width_hz))) == pytest.approx(-43.0, abs=1e-3)
    assert decibels(band_power_mw(levels_dbm, GRID, Band(985e6, 200e3))) == pytest.approx(-40.0, abs=1e-3)


def test_resolution_bandwidth_in_place_of_noise_bandwidth_would_be_seen() -> None:
    power_mw = band_power_mw(FLAT_DBM, GRID, Band(972e6, 1e6))
    wrong_mw = power_mw * GRID.enbw_hz / GRID.rbw_hz
    assert 10 * math.log10(wrong_mw / power_mw) == pytest.approx(0.27, abs=0.005)


@pytest.mark.parametrize(
    "band", [Band(954e6, 1e6), Band(990e6, 100e3), Band(972e6, 36.1e6), Band(900e6, 1e6), Band(972e6, 0.0)]
)
def test_band_that_is_not_wholly_inside_has_no_power(band: Band) -> None:
    assert math.isnan(band_power_mw(FLAT_DBM, GRID, band))


def test_zero_span_has_no_band() -> None:
    standing = SweepGrid(972e6, 972e6, 101, 30e3)
    assert math.isnan(band_power_mw(np.zeros(101), standing, Band(972e6, 1e3)))


def test_shares_of_the_bins_add_up_to_the_width() -> None:
    shares = bin_shares(GRID, Band(970.0012e6, 0.7777e6))
    assert shares.sum() * GRID.spacing_hz == pytest.approx(0.7777e6, rel=1e-9)
    assert np.sum((shares > 0) & (shares < 1)) == 2
