"""Mean trace: filter, carriers, floor."""

import math

import numpy as np
import pytest

from analyzer_sim.emission import Emission, NoiseHump, Signal
from analyzer_sim.instrument.spectrum import (
    ENBW_PER_RBW,
    SweepGrid,
    filter_response,
    mean_trace,
    raised_cosine,
    too_fast_line_loss,
)

GRID = SweepGrid(954e6, 990e6, 2401, 30e3)
NO_NOISE_DBM_HZ = -400.0


def trace_mw(*signals: Signal, grid: SweepGrid = GRID, noise_dbm_hz: float = NO_NOISE_DBM_HZ) -> np.ndarray:
    return mean_trace(Emission(0, signals, noise_dbm_hz), grid, NO_NOISE_DBM_HZ).total_mw


def integrated_dbm(trace: np.ndarray, grid: SweepGrid = GRID) -> float:
    spacing_hz = (grid.stop_hz - grid.start_hz) / (grid.points - 1)
    return 10 * math.log10(float(trace.sum()) * spacing_hz / grid.enbw_hz)


def test_noise_bandwidth_is_the_area_of_the_filter() -> None:
    offset_hz = np.linspace(-5.0, 5.0, 100001)
    area = float(filter_response(offset_hz, 1.0).sum() * 1e-4)
    assert area == pytest.approx(ENBW_PER_RBW, rel=1e-9)  # trapezoids of a Gaussian converge at once
    assert pytest.approx(1.0645, abs=1e-4) == ENBW_PER_RBW


@pytest.mark.parametrize("rolloff", [0.0, 0.05, 0.1, 0.2, 0.25, 0.35, 1.0])
def test_raised_cosine_has_unit_area_and_falls_to_half_at_half_the_symbol_rate(rolloff: float) -> None:
    offset_hz = np.linspace(-1.2e6, 1.2e6, 240001)
    density = raised_cosine(offset_hz, 1e6, rolloff)
    assert float(density.sum() * 10.0) == pytest.approx(1.0, abs=2e-5)  # one 10 Hz step on a hard edge
    assert density.max() == pytest.approx(1e-6, rel=1e-12)
    assert np.all(density[np.abs(offset_hz) > 0.5e6 * (1 + rolloff) + 1] == 0.0)
    if rolloff:
        assert raised_cosine(np.array([0.5e6]), 1e6, rolloff)[0] == pytest.approx(0.5e-6, rel=1e-9)


@pytest.mark.parametrize("rate_hz", [0.2e6, 1e6, 9e6])
@pytest.mark.parametrize("rolloff", [0.05, 0.25, 0.35])
def test_integrated_carrier_is_its_power(rate_hz: float, rolloff: float) -> None:
    trace = trace_mw(Signal("x", 971.3e6, rate_hz, rolloff, -43.0))
    assert integrated_dbm(trace) == pytest.approx(-43.0, abs=5e-4)  # interpolation of the tabulated shape


def test_plateau_is_density_times_noise_bandwidth() -> None:
    trace = trace_mw(Signal("x", 972e6, 9e6, 0.25, -43.0))
    plateau_dbm = 10 * math.log10(trace[1200])
    assert plateau_dbm == pytest.approx(-43.0 - 10 * math.log10(9e6 / GRID.enbw_hz), abs=1e-4)


def test_shape_follows_the_direct_convolution() -> None:
    signal = Signal("x", 972e6, 0.3e6, 0.2, 0.0)
    fine_hz = np.arange(-2e6, 2e6, 200.0)
    density = raised_cosine(fine_hz, 0.3e6, 0.2)
    direct = [
        float((density * filter_response(fine_hz + 972e6 - f, 30e3)).sum() * 200.0)
        for f in GRID.frequency_hz[1180:1221]
    ]
    shape = trace_mw(signal)[1180:1221]
    np.testing.assert_allclose(shape, direct, atol=1e-3 * max(direct))  # claim of the module: 5e-4 of the plateau


def test_line_shows_its_power_at_the_peak_and_the_filter_around() -> None:
    trace = trace_mw(Signal("x", 972e6, 0.0, 0.0, -40.0))
    np.testing.assert_allclose(trace, 1e-4 * filter_response(GRID.frequency_hz - 972e6, 30e3), atol=1e-18)
    assert integrated_dbm(trace) == pytest.approx(-40.0, abs=1e-3)  # spacing of half the filter


def test_floor_adds_input_and_own_noise() -> None:
    mean = mean_trace(Emission(0, (), -150.0), GRID, -150.0)
    expected_dbm = -150.0 + 10 * math.log10(2 * GRID.enbw_hz)
    np.testing.assert_allclose(10 * np.log10(mean.noise_mw), expected_dbm, atol=1e-9)
    assert mean.lines_mw.shape == (0, GRID.points)


def test_powers_of_carriers_add() -> None:
    one = Signal("x", 972e6, 1e6, 0.2, -43.0)
    other = Signal("y", 972.5e6, 2e6, 0.35, -50.0)
    np.testing.assert_allclose(trace_mw(one, other), trace_mw(one) + trace_mw(other), rtol=1e-9, atol=1e-30)


def test_filter_much_wider_or_narrower_than_the_carrier_is_drawn() -> None:
    wide = trace_mw(Signal("x", 972e6, 1.0, 0.25, 0.0), grid=SweepGrid(954e6, 990e6, 1001, 1e6))
    assert 10 * math.log10(wide.max()) == pytest.approx(0.0, abs=0.01)  # the point nearest to the line is 0 Hz off
    narrow = SweepGrid(954e6, 990e6, 1001, 1.0)
    plateau_dbm = 10 * math.log10(trace_mw(Signal("x", 972e6, 9e6, 0.25, 0.0), grid=narrow)[500])
    assert plateau_dbm == pytest.approx(10 * math.log10(ENBW_PER_RBW / 9e6), abs=1e-3)


@pytest.mark.parametrize(("time_s", "loss_db"), [(100.0, 0.0), (0.01, -0.39), (0.001, -6.56)])
def test_line_fades_when_the_sweep_outruns_the_filter(time_s: float, loss_db: float) -> None:
    assert 10 * math.log10(too_fast_line_loss(36e6, 60e3, time_s)) == pytest.approx(loss_db, abs=0.01)


def test_oscillator_of_the_receiving_chain_moves_all_that_arrives() -> None:
    signals = (Signal("x", 970e6, 1e6, 0.2, -40.0), Signal("y", 975e6, 0.0, 0.0, -50.0))
    hump = NoiseHump(980e6, 2e6, -100.0)
    grid = SweepGrid(954e6, 990e6, 3601, 30e3)
    still = mean_trace(Emission(0, signals, -120.0, (hump,)), grid, NO_NOISE_DBM_HZ)
    moved = mean_trace(Emission(0, signals, -120.0, (hump,), 50e3), grid, NO_NOISE_DBM_HZ)
    np.testing.assert_allclose(moved.total_mw[5:], still.total_mw[:-5], rtol=1e-9)  # five points of 10 kHz
    assert moved.line_hz.tolist() == [975.05e6]


@pytest.mark.parametrize("width_hz", [10e3, 300e3, 5e6])
def test_hump_of_noise_has_its_density_and_its_power_through_the_filter(width_hz: float) -> None:
    hump = NoiseHump(972e6, width_hz, -100.0)
    trace = mean_trace(Emission(0, (), NO_NOISE_DBM_HZ, (hump,)), GRID, NO_NOISE_DBM_HZ).total_mw
    power_dbm = -100.0 + 10 * math.log10(ENBW_PER_RBW * width_hz)  # a Gaussian, as the filter is
    assert integrated_dbm(trace) == pytest.approx(power_dbm, abs=0.01)
    if width_hz > 1e6:
        density_dbm_hz = 10 * math.log10(trace.max() / GRID.enbw_hz)
        assert density_dbm_hz == pytest.approx(-100.0, abs=0.001)  # 30 kHz of 5 MHz


def test_neighbour_that_grows_leaks_what_its_shape_says_and_no_more() -> None:
    wanted = Signal("x", 970e6, 1e6, 0.2, -43.0)
    alone = trace_mw(wanted)
    for growth_db in (0.0, 6.0, 12.0):
        neighbour = Signal("y", 971.6e6, 1e6, 0.2, -43.0 + growth_db)
        both = trace_mw(wanted, neighbour)
        np.testing.assert_allclose(both - alone, trace_mw(neighbour), rtol=1e-6, atol=1e-18)
