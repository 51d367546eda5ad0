"""Traces: mean, channel power, numbers in blocks, plans that can be swept, streams of noise, statistics."""

import math
from dataclasses import replace

import numpy as np
import pytest

from analyzer_sim.emission import Emission, NoiseHump, Signal
from analyzer_sim.epochs import epoch_us_from_text, rfc3339
from analyzer_sim.instrument.channel_power import Band, band_power_mw, bin_shares, decibels
from analyzer_sim.instrument.imperfections import IDEAL
from analyzer_sim.instrument.instrument_settings import FSW_26, reset_state
from analyzer_sim.instrument.levels import ENCODERS, UNITS, ascii_list, definite_block
from analyzer_sim.instrument.painter import TracePainter
from analyzer_sim.instrument.quantities import store
from analyzer_sim.instrument.spectrum import (
    ENBW_PER_RBW,
    SweepGrid,
    filter_response,
    mean_trace,
    raised_cosine,
    too_fast_line_loss,
)
from analyzer_sim.streams import stream
from analyzer_sim.world.ground.ground import task
from analyzer_sim.world.payload.level_terms import sweep_sigma_db
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World

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


#: 3 dB width of 30 kHz, noise bandwidth of a Gaussian
FLAT_DBM = np.full(2401, -100.0 + 10 * math.log10(30e3 * math.sqrt(math.pi / (4 * math.log(2)))))


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
    levels_dbm = 10 * np.log10(trace_mw(carrier, line))
    width_hz = 1.25 * rate_hz + 200e3
    assert decibels(band_power_mw(levels_dbm, GRID, Band(971.3e6, width_hz))) == pytest.approx(-43.0, abs=1e-3)
    assert decibels(band_power_mw(levels_dbm, GRID, Band(985e6, 200e3))) == pytest.approx(-40.0, abs=1e-3)


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


@pytest.mark.parametrize("length", [0, 9, 10, 99, 100, 128004])
def test_block_header_tells_the_length(length: int) -> None:
    block = definite_block(bytes(length))
    digits = int(block[1:2])
    assert int(block[2 : 2 + digits]) == length
    assert len(block) == 2 + digits + length


def test_list_has_no_blanks_and_no_trailing_comma() -> None:
    assert ascii_list(np.array([-1.0, 2.0, 3.5])) == "-1.000000E+00,2.000000E+00,3.500000E+00"


@pytest.mark.parametrize(
    ("key", "kind", "scale"), [("REAL,32", "f4", 1.0), ("REAL,64", "f8", 1.0), ("INT,32", "i4", 1e-3)]
)
@pytest.mark.parametrize(("is_big_endian", "order"), [(True, ">"), (False, "<")])
def test_every_encoder_has_its_type_and_byte_order(
    key: str, kind: str, scale: float, is_big_endian: bool, order: str
) -> None:
    values = np.array([-42.5, 0.001, 17.0])
    block = ENCODERS[key](values, is_big_endian=is_big_endian)
    np.testing.assert_allclose(scale * np.frombuffer(block[4:], order + kind), values, rtol=1e-7, atol=1e-9)


def test_integers_beyond_32_bits_stand_at_the_limit() -> None:
    block = ENCODERS["INT,32"](np.array([1e12, -1e12]), is_big_endian=False)
    assert np.frombuffer(block[3:], "<i4").tolist() == [2**31 - 1, -(2**31)]


def test_units_of_voltage_and_current_follow_from_50_ohm() -> None:
    level = np.array([13.0103])  # 1 V
    voltages = {"V": 1.0, "DBV": 0.0, "DBMV": 60.0, "DBUV": 120.0}
    others = {"A": 0.02, "DBMA": 26.02, "DBUA": 86.02, "W": 0.02, "DBPW": 103.01}
    for unit, value in (voltages | others).items():
        assert UNITS[unit](level)[0] == pytest.approx(value, rel=1e-4, abs=1e-5)


SEED = 3
ROWS = 30


def mean_power_dbm(world: World, rows: range, columns: list[int]) -> np.ndarray:
    """Sweep rows as the task says and return the mean integrated powers (columns,), noise subtracted."""
    sweep = task(world, world.plan_versions[-1].carriers)["sweeps"][0]
    settings = replace(reset_state(FSW_26), detector="RMS")
    for name in ("start_hz", "stop_hz", "rbw_hz", "points", "time_s"):
        store(settings, name, sweep[name])
    axis_hz = np.linspace(settings.start_hz, settings.stop_hz, settings.points)
    carriers = [world.plan.carriers[k] for k in columns]
    bands = np.array([np.abs(axis_hz - c.center_hz) <= 0.5 * c.bandwidth_hz + 30e3 for c in carriers])
    quiet = np.any([(axis_hz > low) & (axis_hz < high) for low, high in world.plan.noise_windows_hz], axis=0)
    painter = TracePainter(SEED, IDEAL)
    powers = []
    for row in rows:
        power_mw = 10.0 ** (painter.paint(world.emission(row), settings).level_dbm / 10.0)
        floor_mw = power_mw[quiet].mean()
        powers.append((power_mw - floor_mw) @ bands.T * (axis_hz[1] - axis_hz[0]) / (ENBW_PER_RBW * settings.rbw_hz))
    return 10.0 * np.log10(np.mean(powers, axis=0))


@pytest.mark.parametrize(
    "name", ["nominal", "few8", "many32", "dual_band", "stale_calibration", "flicker", "sun_outage", "beacons"]
)
def test_a_sweep_reads_the_powers_of_the_world(name: str) -> None:
    world = World(replace(scenario_named(name), quiet_h=1.0, operation_h=24.0), SEED)
    first = len(world.rows.epochs_us) - 600
    if name == "sun_outage":
        first = int(np.argmax(world.rows.sun_noise_db)) - ROWS // 2
    rows = range(first, first + ROWS)
    columns = np.flatnonzero(world.rows.is_on[first]).tolist()
    expected_mw = 10.0 ** (world.rows.power_dbm[rows.start : rows.stop, columns] / 10.0)
    error_db = mean_power_dbm(world, rows, columns) - 10.0 * np.log10(expected_mw.mean(axis=0))
    print(f"{name}: {len(columns)} carriers, error mean {error_db.mean():.3f}, largest {np.abs(error_db).max():.3f} dB")
    # thirty sweeps of some 0.1 dB each: 0.02 dB, four sigmas; half as much again for noise ten times up
    assert np.abs(error_db).max() < 6.0 * sweep_sigma_db(world.plan).max() / np.sqrt(ROWS)


def test_same_seed_and_name_give_the_same_numbers() -> None:
    assert stream(3, "white", "c00").normal(size=5).tolist() == stream(3, "white", "c00").normal(size=5).tolist()


def test_another_seed_or_name_gives_other_numbers() -> None:
    base = stream(3, "white", "c00").normal()
    assert base not in {stream(4, "white", "c00").normal(), stream(3, "white", "c01").normal(), stream(3).normal()}


def test_a_longer_series_begins_with_the_shorter_one() -> None:
    assert stream(3, "a").normal(size=4).tolist() == stream(3, "a").normal(size=9)[:4].tolist()


def test_text_has_six_decimals_and_z() -> None:
    assert rfc3339(1_793_491_200_000_007) == "2026-11-01T00:00:00.000007Z"


@pytest.mark.parametrize("epoch_us", [0, 1, 951_782_400_123_456, 1_793_491_200_000_000])
def test_round_trip_is_exact(epoch_us: int) -> None:
    assert epoch_us_from_text(rfc3339(epoch_us)) == epoch_us


def test_a_text_without_zone_is_refused() -> None:
    with pytest.raises(ValueError, match="time zone"):
        epoch_us_from_text("2026-11-01T00:00:00")
