"""The global optimum of the octants against an exhaustive grid and an independent active-set optimiser."""

import itertools

import numpy as np
import pytest
from scipy.optimize import nnls

from service.core.estimation.paper.octants import predict_deviation_db, solve_octants

#: deg, every hundredth from -0.6 to 0.6.
GRID_DEG = np.arange(-60, 61) / 100.0


def random_model(rng, carriers):
    steep = rng.normal(0.0, [0.16, 1.4, 1.2], (carriers, 3))
    bend = rng.normal([0.0, 0.5, 0.28], [0.05, 0.3, 0.2], (carriers, 3))
    return steep - bend, steep + bend


def grid_minimum(plus, minus, deviation_db):
    """Return the least cost among all 121^3 points; the cost splits into terms of one and of two angles."""
    # answer[j, k] = what angle j at grid point k adds to the carriers, shape (3, 121, N)
    answer = np.where(GRID_DEG[:, None] >= 0.0, plus.T[:, None, :], minus.T[:, None, :]) * GRID_DEG[:, None]
    single = np.einsum("jkn,jkn->jk", answer, answer) - 2.0 * answer @ deviation_db
    yaw_roll = 2.0 * answer[0] @ answer[1].T + single[0][:, None] + single[1]
    yaw_pitch = 2.0 * answer[0] @ answer[2].T + single[2]
    roll_pitch = 2.0 * answer[1] @ answer[2].T
    least, plane = np.inf, np.empty((121, 121))
    for yaw in range(121):
        np.add(roll_pitch, yaw_pitch[yaw], out=plane)
        least = min(least, float((plane.min(axis=1) + yaw_roll[yaw]).min()))
    return least + deviation_db @ deviation_db


def polished(plus, minus, deviation_db):
    """Return cost and angles of the best of eight non-negative least squares, one an octant."""
    fits = []
    for signs in np.array(list(itertools.product((1.0, -1.0), repeat=3))):
        angles, misfit = nnls(np.where(signs > 0.0, plus, minus) * signs, deviation_db)
        fits.append((misfit**2, signs * angles))
    return min(fits, key=lambda pair: pair[0])


@pytest.mark.parametrize("carriers", [5, 16, pytest.param(8, marks=pytest.mark.slow)])
@pytest.mark.parametrize("noise_db", [0.05, pytest.param(0.0, marks=pytest.mark.slow)])
def test_never_above_the_polished_grid(carriers, noise_db):
    seed = 1000 + 10 * carriers + round(100 * noise_db)
    print("seed", seed)
    rng = np.random.default_rng(seed)
    compared = 0
    for _ in range(200):
        plus, minus = random_model(rng, carriers)
        deviation_db = predict_deviation_db(plus, minus, rng.uniform(-0.4, 0.4, 3))
        deviation_db += noise_db * rng.standard_normal(carriers)
        cost, attitude_deg = polished(plus, minus, deviation_db)
        fix = solve_octants(plus, minus, deviation_db, None)
        # the bound asked for; rounding is 1e-15
        assert fix.cost <= min(cost, grid_minimum(plus, minus, deviation_db)) + 1e-9
        if fix.second_best_cost > fix.cost + 1e-6:
            compared += 1
            # asked for: 1e-4 deg; both are exact, so rounding at a condition of about 1e3 is enough
            np.testing.assert_allclose(fix.attitude_deg, attitude_deg, rtol=0.0, atol=1e-9)
    assert compared > 100
