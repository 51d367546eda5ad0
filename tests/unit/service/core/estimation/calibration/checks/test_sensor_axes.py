"""Axes of the sensor judged by free slopes: every mistake is found, a healthy sensor is not accused."""

import numpy as np
import pytest

from service.core.estimation.calibration.checks.free_response import FreeResponse
from service.core.estimation.calibration.checks.sensor_axes import DECISIVE, MAPPINGS, MIN_CARRIERS, judge_axes
from service.core.estimation.calibration.geometry_columns import CarrierGeometry

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
    print(f"scatter in sigmas {score.std(axis=0)}")
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
