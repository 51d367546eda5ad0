"""Verdicts of the calibration on sensors, wheels, feed and station."""

import math
from dataclasses import replace

import numpy as np
import pytest
from geometry_payload import GeometryPayload
from turned_wheels import ALIKE, INERTIA_KG_M2, WRONG, Turned, turned_deg, turned_wheels

from analyzer_sim.world.scenario.story import WheelTelemetry
from service.core.estimation.calibration.geometry_calibration import fit_geometry
from service.core.estimation.calibration.geometry_columns import CarrierGeometry
from service.core.estimation.calibration.responses import (
    AngleResponse,
    angle_response,
    feed_leakage,
    feed_turn,
    momentum_response,
    rate_response,
)
from service.core.estimation.calibration.sensor_axes import (
    DECISIVE,
    MAPPINGS,
    MIN_CARRIERS,
    FreeResponse,
    judge_axes,
)
from service.core.estimation.filtering.filter_model import PolarimeterModel
from service.core.estimation.filtering.polarimeter import AngleBlock
from service.pipeline.calibration.geometry_rows import geometry_rows
from service.pipeline.config import CalibrationConfig

READ = PolarimeterModel((0.99, -0.07, -0.13))
BLOCK_US, BLOCKS, BLOCK_H = 300_000_000, 864, 1.0 / 12.0
TRUE_DEG = np.array([0.8, 0.03, -0.02])


def blocks(seed, moved_deg=0.0, scatter=1.0):
    """Return three days of an offset, a wave, a wander of the stated size and noise; the feed moves after two."""
    rng, at_us = np.random.default_rng(seed), BLOCK_US * np.arange(1, BLOCKS + 1)
    keep = math.exp(-BLOCK_H / READ.wander_h)
    wander = [rng.normal(0.0, READ.wander_deg)]
    for shock in rng.normal(0.0, READ.wander_deg * math.sqrt(1.0 - keep**2), BLOCKS - 1):
        wander.append(keep * wander[-1] + shock)
    phase = 2.0 * math.pi * at_us / 86_400e6
    wave = np.column_stack([np.ones(BLOCKS), np.cos(phase), np.sin(phase)]) @ TRUE_DEG
    angle = wave + np.array(wander) + moved_deg * (at_us > 2 * 86_400e6) + rng.normal(0.0, 0.04 * scatter, BLOCKS)
    told = zip(at_us.tolist(), angle.tolist(), strict=True)
    return [AngleBlock(epoch_us, angle_deg, 0.04**2, -55.0) for epoch_us, angle_deg in told]


def test_offset_and_wave_are_right_within_the_sigmas_that_are_stated():
    squares = []
    for seed in range(1, 21):
        found = feed_turn(blocks(seed), READ)
        off = np.array(found.mean) - TRUE_DEG
        squares.append(off @ np.linalg.solve(np.array(found.covariance), off))
        assert np.sqrt(np.diag(found.covariance)).max() < 0.03
    assert 1.5 < float(np.mean(squares)) < 5.0


def test_a_feed_that_moved_on_the_way_is_where_it_stands_at_the_end():
    found = feed_turn(blocks(1, moved_deg=0.6), READ)
    assert found.mean[0] == pytest.approx(TRUE_DEG[0] + 0.6, abs=4.0 * math.sqrt(found.covariance[0][0]))


def test_blocks_that_contradict_one_another_and_none_tell_nothing():
    assert feed_turn(blocks(1, scatter=8.0), READ) is None
    assert feed_turn([], READ) is None


def test_a_steep_feed_has_its_leakage_by_isolation_and_a_flat_one_by_the_turns():
    leak = 0.03
    for turn_deg, sigma_deg in ((5.0, 0.7), (45.0, 0.57)):
        slope = 1.0 - leak * math.sin(math.radians(2.0 * turn_deg))
        found = feed_leakage(AngleResponse(slope, 0.0168), turn_deg)
        share = 1.0 - (found.sigma_deg / math.degrees(10.0**-1.75 / math.sqrt(2.0))) ** 2
        assert found.sigma_deg == pytest.approx(sigma_deg, rel=0.05)
        assert found.leakage_deg == pytest.approx(share * math.degrees(leak))
    assert feed_leakage(AngleResponse(math.nan, math.nan), 10.0).leakage_deg == 0.0


def offsets(payload, east_deg=0.0, north_deg=0.0):
    """Return what is found where the first station is entered so far from its place in the antenna frame."""
    rows = geometry_rows(payload.data(), CalibrationConfig())
    geometry = rows.positions.geometry
    shift = np.zeros(len(payload.carriers))
    shift[0] = 1.0
    moved = geometry._replace(
        azimuth_deg=geometry.azimuth_deg + east_deg * shift, elevation_deg=geometry.elevation_deg + north_deg * shift
    )
    return fit_geometry(rows.rows, moved).offsets


@pytest.mark.parametrize("seed", [5, 6])
def test_stations_in_their_places(seed):
    found = offsets(GeometryPayload.make(8, seed=seed))
    assert (found.chi_square < 14.0).all()  # two degrees of freedom: one in a thousand


@pytest.mark.parametrize(("east_deg", "north_deg"), [(4.0, 0.0), (-4.0, 0.0), (0.0, 4.0), (0.0, -3.0)])
def test_a_wrong_place_is_found(east_deg, north_deg):
    payload = GeometryPayload.make(8)
    beam = payload.beam.copy()
    # yaw moves a station across the line to it: a slope along azimuth tells its elevation, and the other way round
    beam[0, :2] = (0.3, 2.2) if east_deg else (2.2, 0.3)
    found = offsets(replace(payload, beam=beam), east_deg, north_deg)
    assert int(np.argmax(found.chi_square)) == 0
    assert found.chi_square[0] > 16.0  # the limit of the warning
    seen = found.offset_deg[0] @ [bool(east_deg), bool(north_deg)]
    assert seen == pytest.approx(-(east_deg + north_deg), abs=1.5)  # linear in the error, and held by the prior


def test_a_flat_carrier_tells_nothing():
    payload = GeometryPayload.make(8)
    beam = payload.beam.copy()
    beam[0] = 0.0
    found = offsets(replace(payload, beam=beam), 4.0)
    assert np.sqrt(np.diag(found.covariance_deg2[0])).min() > 5.0
    assert found.chi_square[0] < 6.0


SEEDS = range(1, 25)


@pytest.fixture(scope="module")
def flights():
    return [turned_wheels(seed) for seed in SEEDS]


def responding(turned, matrix=None, is_unloading=None):
    """Return the response of records that report the matrix times the truth."""
    reported = turned.momentum if matrix is None else turned.momentum @ np.asarray(matrix).T
    none = np.zeros(len(reported), dtype=np.bool_)
    epochs_s = (turned.epochs_us - turned.epochs_us[:1]) / 1e6
    flags = none if is_unloading is None else is_unloading
    return momentum_response(epochs_s, reported, turned.attitude_deg, turned.is_slewing, flags, np.array(INERTIA_KG_M2))


def test_true_telemetry_passes_on_every_seed(flights):
    found = [responding(turned) for turned in flights]
    sigmas = [one.deviation(0.005) for one in found]
    assert all(one.is_determined for one in found)
    assert max(sigmas) < 3.5
    normal = np.array([(one.coefficient - 1.0) / one.sigma for one in found])[:, [0, 2]]
    assert 0.6 < np.sqrt(np.mean(normal**2)) < 1.5


@pytest.mark.parametrize("name", WRONG)
def test_wrong_telemetry_deviates_on_every_seed(flights, name):
    sigmas = [responding(turned, WRONG[name]).deviation(0.005) for turned in flights]
    assert min(sigmas) > 5.0


@pytest.mark.parametrize("name", ALIKE)
def test_a_factor_that_all_axes_share_moves_the_mean_alone(flights, name):
    right, wrong = responding(flights[0]), responding(flights[0], ALIKE[name] * np.eye(3))
    assert wrong.deviation(0.005) < 4.0
    np.testing.assert_allclose(wrong.mean_n_m_s, ALIKE[name] * right.mean_n_m_s)


def test_telemetry_of_another_spacecraft_deviates(flights):
    rng = np.random.default_rng(4)
    for turned in flights:
        other = np.array([0.4, -9.0, 0.3]) + 0.01 * rng.normal(size=turned.momentum.shape)
        assert responding(turned._replace(momentum=other)).deviation(0.005) > 5.0


@pytest.mark.parametrize("records", [6, 24])
def test_telemetry_that_is_late_deviates_or_tells_nothing(flights, records):
    for turned in flights:
        before = turned.momentum[0] + 0.01 * np.random.default_rng(5).normal(size=(records, 3))
        found = responding(turned._replace(momentum=np.concatenate([before, turned.momentum[:-records]])))
        assert found.deviation(0.005) > 5.0 or not found.is_determined


def test_without_momentum_along_pitch_nothing_is_determined():
    for seed in SEEDS:
        found = responding(turned_wheels(seed, replace(WheelTelemetry(), bias_n_m_s=0.0)))
        assert not found.is_determined
        assert found.deviation(0.005) < 3.5


@pytest.mark.parametrize("is_marked", [True, False])
def test_the_longest_stretch_between_unloadings_is_used(is_marked):
    for seed in SEEDS:
        turned = turned_wheels(seed, start_h=6.0)
        at = int(np.searchsorted(turned.epochs_us, turned.epochs_us[0] + 360 * 60_000_000))
        flags = np.zeros(len(turned.epochs_us), dtype=np.bool_)
        flags[at] = is_marked
        found = responding(turned, is_unloading=flags)
        assert found.stretches <= 2
        assert found.stretches == 2 or not is_marked
        assert found.records < np.count_nonzero(~turned.is_slewing) or not is_marked
        assert found.deviation(0.005) < 3.5


def test_too_few_records_determine_nothing(flights):
    few = Turned(*(part[:6] for part in flights[0]))
    found = responding(few)
    assert not found.is_determined
    assert found.deviation(0.005) == 0.0
    assert np.isnan(responding(Turned(*(part[:0] for part in flights[0]))).mean_n_m_s).all()


SIGHT = np.array([0.99, -0.07, -0.13])


def response(seed, scale=1.0, *, turns=1.0):
    """Return the response of an angle of a scale with noise, offset, drift and wander."""
    rng, angles = np.random.default_rng(seed), turns * turned_deg()
    hours = np.arange(len(angles)) / 60.0
    wander = np.convolve(rng.normal(0.0, 0.04 * math.sqrt(1 / 60.0), len(angles)), np.exp(-hours / 4.0))[: len(angles)]
    measured = scale * angles @ SIGHT + 1.3 + 0.03 * np.cos(0.26 * hours) + wander + rng.normal(0.0, 0.07, len(angles))
    measured[7] = math.nan
    return angle_response(hours, measured, (angles + rng.normal(0.0, 0.01, angles.shape)) @ SIGHT)


@pytest.mark.parametrize("seed", range(1, 21))
def test_a_true_instrument_agrees_and_a_wrong_one_does_not(seed):
    found = response(seed)
    assert found.is_determined
    assert found.deviation() < 3.5
    for scale in (-1.0, 0.5, 1.5, 2.0):
        assert response(seed, scale).deviation() > 3.5


def test_turns_that_tell_nothing_determine_nothing():
    assert not response(1, turns=0.0).is_determined
    assert response(1, turns=0.0).deviation() == 0.0
    few = angle_response(np.arange(5.0), np.arange(5.0), np.arange(5.0))
    assert math.isnan(few.sigma)
    assert few.deviation() == 0.0
    nothing = angle_response(np.arange(3.0), np.full(3, np.nan), np.zeros(3))
    assert math.isnan(nothing.coefficient)


NO_TURNS = (np.zeros((0, 3)), np.zeros((0, 3)))
SIGMA = 0.06


def payload(seed, carriers=16, *, has_beams=True, noise=SIGMA):
    """Return true slopes and curvatures of carriers in four beams, and where they stand."""
    rng = np.random.default_rng(seed)
    geometry = CarrierGeometry(
        rng.uniform(-5.2, 5.0, carriers),
        rng.uniform(6.3, 8.5, carriers),
        np.array([-4.0, 7.5]),
        np.zeros(carriers, int),
    )
    beam = np.arange(carriers) % 4
    position = np.column_stack([geometry.azimuth_deg, geometry.elevation_deg])
    hessian = np.array([[-1.3, 0.1], [0.1, -2.4]])
    centre = np.array([[-3.0, 6.8], [-2.4, 8.0], [0.0, 8.0], [3.7, 6.9]])[beam]
    gradient = (position - centre) @ hessian + rng.normal(0.0, 0.15, (carriers, 2))
    if not has_beams:
        gradient = rng.normal(0.0, 1.4, (carriers, 2))
    matrix = geometry.displacement()
    own, site = matrix[:-1], matrix[-1]
    slope = np.einsum("nij,ni->nj", own, gradient) + np.einsum("nij,i->nj", site - own, rng.normal(0.0, 0.3, 2))
    curvature = np.einsum("nai,ab,nbj->nij", own, hessian, own)
    sigma = noise * np.array([1.0, 0.3, 0.3])
    covariance = np.tile(np.diag(np.maximum(sigma, 1e-5) ** 2), (carriers, 1, 1))
    return FreeResponse(slope + sigma * rng.normal(size=slope.shape), curvature, covariance), geometry, beam


def told_by(free, mapping):
    """Return the answer about the axes of a sensor whose angles the mapping corrects."""
    return FreeResponse(
        free.slope @ mapping, mapping.T @ free.curvature @ mapping, mapping.T @ free.covariance @ mapping
    )


def verdict(free, geometry, beam, turns=NO_TURNS):
    return judge_axes(free, geometry, beam, np.ones(len(beam), dtype=bool), turns)


@pytest.mark.parametrize("k", range(48))
def test_every_exchange_and_flip_is_found_by_five_sigma(k):
    free, geometry, beam = payload(11)
    found = verdict(told_by(free, MAPPINGS[k]), geometry, beam)
    assert int(found.chi_square.argmin()) == k
    others = np.delete(found.chi_square, k)
    assert others.min() > found.chi_square[k] + (DECISIVE if k else 0.0)
    if k:
        assert found.chi_square[0] > found.chi_square[k] + DECISIVE


@pytest.mark.parametrize(
    ("flips", "expected"),
    [
        ((-1, 1, 1), (-1, -1)),
        ((1, -1, -1), (-1, -1)),
        ((1, -1, 1), (1, -1)),
        ((-1, 1, -1), (1, -1)),
        ((1, 1, -1), (-1, 1)),
        ((-1, -1, 1), (-1, 1)),
        ((-1, -1, -1), (1, 1)),
    ],
)
def test_each_flip_shows_in_the_two_coefficients(flips, expected):
    free, geometry, beam = payload(12, noise=0.0)
    found = verdict(told_by(free, np.diag(np.array(flips, dtype=float))), geometry, beam)
    # products of two angles of a station, 1 %, are left out where an axis is flipped
    assert found.coefficient == pytest.approx(expected, abs=0.04)


@pytest.mark.parametrize(("axis", "expected"), [(0, (0.5, 0.5)), (1, (1.0, 2.0)), (2, (2.0, 1.0))])
def test_a_scale_shows_in_the_coefficients_and_is_no_contradiction(axis, expected):
    free, geometry, beam = payload(13, carriers=32, noise=0.02)
    scale = np.ones(3)
    scale[axis] = 2.0  # the sensor reads twice the angle
    found = verdict(told_by(free, np.diag(1.0 / scale)), geometry, beam)
    np.testing.assert_array_less(np.abs(found.coefficient - expected), 5.0 * found.sigma)
    assert found.chi_square.argmin() == 0


def test_the_sigmas_are_those_of_repeated_noise():
    drawn = [verdict(*payload(seed, has_beams=False)) for seed in range(60)]
    score = np.array([(one.coefficient - 1.0) / one.sigma for one in drawn])
    # sixty draws: one sigma of a scatter is 9 %
    assert (score.std(axis=0) > 0.7).all()
    assert (score.std(axis=0) < 1.3).all()
    assert np.abs(score).max() < 5.0


def test_without_beams_and_announcements_the_common_sign_is_open():
    free, geometry, beam = payload(14, has_beams=False)
    assert verdict(free, geometry, beam).margin(-1, -1, -1) == pytest.approx(0.0, abs=1e-9)
    assert verdict(free, geometry, beam).margin(-1, 1, 1) > DECISIVE


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_announced_corrections_tell_the_common_sign(sign):
    free, geometry, beam = payload(14, has_beams=False)
    announced = np.array([[0.0, 0.25, 0.0], [0.0, -0.25, 0.0], [0.0, 0.0, 0.3], [np.nan, 0.0, 0.0]])
    reported = sign * announced + np.random.default_rng(1).normal(0.0, 0.01, announced.shape)
    found = verdict(told_by(free, sign * np.eye(3)), geometry, beam, (announced, reported))
    assert sign * found.margin(-1, -1, -1) > DECISIVE


def test_announcements_that_the_sensor_does_not_follow_say_nothing():
    free, geometry, beam = payload(14, has_beams=False)
    announced = np.array([[0.0, 0.25, 0.0], [0.0, -0.25, 0.0], [0.0, 0.25, 0.0]])
    reported = np.array([[0.0, 0.25, 0.0], [0.0, 0.25, 0.0], [0.0, 0.0, 0.0]])
    assert verdict(free, geometry, beam, (announced, reported)).margin(-1, -1, -1) == pytest.approx(0.0, abs=1e-9)


def test_too_few_carriers_give_no_verdict():
    assert verdict(*payload(15, carriers=MIN_CARRIERS - 1)) is None
    assert verdict(*payload(15, carriers=MIN_CARRIERS)) is not None


def test_beams_without_any_slope_give_finite_figures_and_no_contradiction():
    free, geometry, beam = payload(16)
    flat = FreeResponse(np.zeros_like(free.slope), np.zeros_like(free.curvature), np.zeros_like(free.covariance))
    found = verdict(flat, geometry, beam)
    assert np.isfinite([*found.coefficient, *found.sigma, *found.chi_square]).all()
    assert found.chi_square[0] <= found.chi_square.min()


W_PER_H = 0.2625162


def rates_response(matrix, *, rest=0.0, every=1, sensor_deg=0.01):
    """Return the response of rates that are a matrix times the truth."""
    rng, angles = np.random.default_rng(5), turned_deg()
    hours = np.arange(len(angles)) / 60.0
    turned = np.diff(angles, axis=0) * 60.0
    yaw, roll, pitch = (0.5 * (angles[1:] + angles[:-1])).T
    turned += W_PER_H * np.column_stack([roll, -yaw, 0.0 * pitch])
    rates = np.vstack([np.zeros(3), turned]) @ matrix.T + rest + rng.normal(0.0, 0.02, angles.shape)
    kept = slice(None, None, every)
    return rate_response(hours[kept], rates[kept], (angles + rng.normal(0.0, sensor_deg, angles.shape))[kept])


def test_true_rates_agree():
    found = rates_response(np.eye(3))
    assert found.is_determined
    np.testing.assert_allclose(found.coefficient, np.eye(3), atol=0.1)
    assert found.deviation(0.01) < 3.5


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([-1.0, 1.0, 1.0]),
        np.diag([1.0, -1.0, 1.0]),
        np.diag([1.0, 1.0, -1.0]),
        np.eye(3)[[1, 0, 2]],
        np.eye(3)[[0, 2, 1]],
        np.eye(3)[[1, 2, 0]],
        3600.0 * np.eye(3),
        np.pi / 180.0 * np.eye(3),
        np.diag([0.75, 1.0, 1.0]),
    ],
)
def test_wrong_rates_are_found(matrix):
    assert rates_response(matrix).deviation(0.01) > 3.5


def test_a_rate_at_rest_that_no_bias_explains_is_found():
    assert rates_response(np.eye(3), rest=1.0).deviation(0.01) > 3.5
    assert rates_response(np.eye(3), rest=1.0).deviation(2.0) < 3.5


def test_rates_that_stand_still_tell_nothing():
    angles = turned_deg()
    found = rate_response(np.arange(len(angles)) / 60.0, np.full((len(angles), 3), 0.3), angles)
    assert (found.spans, found.is_determined, found.deviation(0.01)) == (0, False, 0.0)
