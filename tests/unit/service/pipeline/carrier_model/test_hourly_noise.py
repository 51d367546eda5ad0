"""Noise of an hour's mean and error of a calibrated daily change, against the same by simulation."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import START_US, FlightPayload

from service.pipeline.carrier_model.hourly_noise import daily_error_db, hourly_sigma_db
from service.records.calibration import Window
from service.records.noise import NoiseComponent

SEED = 6
DAY_US = 86_400_000_000


def process(rng, part, rows, step_s=60.0):
    """Return a process of the first order, rows a minute."""
    keep = np.exp(-step_s / part.correlation_time_s)
    drawn = rng.normal(0.0, part.sigma_db, rows)
    for k in range(1, rows):
        drawn[k] = keep * drawn[k - 1] + np.sqrt(1.0 - keep**2) * drawn[k]
    return drawn


@pytest.fixture(scope="module")
def result():
    result = FlightPayload.make().calibration().result
    carriers = tuple(
        replace(one, sigma_white_db=0.08, noise=(NoiseComponent(1200.0, 0.09),)) for one in result.carriers
    )
    return replace(result, carriers=carriers)


def test_sigma_of_an_hour_is_that_of_drawn_noise(result):
    rng = np.random.default_rng(SEED)
    carrier = result.carriers[0]
    drawn = process(rng, carrier.noise[0], 60 * 3000) + rng.normal(0.0, carrier.sigma_white_db, 60 * 3000)
    measured = drawn.reshape(-1, 60).mean(axis=1).std()
    stated = hourly_sigma_db(carrier, np.array([60, 60, 0, 59]))
    print("seed", SEED, measured, stated)
    assert stated == pytest.approx(measured, rel=0.06)
    assert hourly_sigma_db(carrier, np.array([5, 5])) > stated, "an hour of five rows is less sure"
    assert np.isfinite(hourly_sigma_db(carrier, np.zeros(2, dtype=np.int64)))


def test_error_of_the_daily_change_is_that_of_drawn_noise(result):
    rng = np.random.default_rng(SEED + 1)
    rows, part = 3 * 1440, result.carriers[0].noise[0]
    angle = 2 * np.pi * np.arange(rows) / 1440
    design = np.column_stack([np.ones(rows), np.cos(angle), np.sin(angle)])
    waves = [np.linalg.lstsq(design, process(rng, part, rows), rcond=None)[0][1:] for _ in range(120)]
    measured = float(np.sqrt(np.mean(np.square(waves))))
    fit = replace(result.geometry, daily_error_db=(0.04,) * len(result.carriers))
    quiet = Window(START_US - 3 * DAY_US, START_US)
    soon = daily_error_db(result, fit, quiet, np.array([START_US + DAY_US]))
    print("seed", SEED + 1, measured, soon[0])
    # 240 parts: a sigma of five percent
    np.testing.assert_allclose(soon, measured, rtol=0.2)
    later = daily_error_db(result, fit, quiet, np.array([START_US + 60 * DAY_US]))
    assert (later > 1.5 * soon).all(), "the orbit's day has moved by two months"
    half_year = daily_error_db(result, fit, quiet, np.array([START_US + 181 * DAY_US]))
    np.testing.assert_allclose(half_year, np.hypot(0.08, soon), rtol=0.05)
    assert np.isfinite(daily_error_db(result, fit, quiet, np.zeros(0, dtype=np.int64))).all()
