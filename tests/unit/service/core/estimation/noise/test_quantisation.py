"""Step of the readings: found through drift and added noise, absent where there is none."""

import numpy as np
import pytest

from service.core.estimation.noise.quantisation import quantisation_step_db


def level(seed, spread_db=0.2, rows=4000):
    rng = np.random.default_rng(seed)
    return -43.21 + 0.2 * np.sin(np.arange(rows) / 200.0) + spread_db * rng.normal(size=rows)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("step_db", [0.02, 0.1, 0.15, 0.3])
def test_a_grid_is_found_whatever_its_step(seed, step_db):
    found = quantisation_step_db((np.round(level(seed) / step_db) * step_db).astype(np.float32))
    assert found == pytest.approx(step_db, rel=0.03)  # resolution of the transform


@pytest.mark.parametrize("seed", range(4))
def test_noise_added_after_the_rounding_blurs_the_grid_but_does_not_hide_it(seed):
    rounded = np.round(level(seed) / 0.15) * 0.15
    noise = np.random.default_rng(seed + 50).normal(size=len(rounded))
    assert quantisation_step_db(rounded + 0.03 * noise) == pytest.approx(0.15, rel=0.03)
    assert quantisation_step_db(rounded + 0.15 * noise) == 0.0


@pytest.mark.parametrize("seed", range(20))
def test_smooth_readings_have_no_step(seed):
    assert quantisation_step_db(level(seed).astype(np.float32)) == 0.0


def test_outliers_do_not_make_a_grid():
    values = level(3)
    values[::10] -= 6.0
    assert quantisation_step_db(values) == 0.0


@pytest.mark.parametrize("values", [np.zeros(0), np.full(500, np.nan), np.full(500, -40.0), level(1, rows=100)])
def test_too_little_to_say(values):
    assert quantisation_step_db(values) == 0.0
