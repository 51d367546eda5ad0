"""Scenario `flicker`: the figures measured on 284 real links over 11 days, as an analyzer's row shows them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from simulated_gain import attitude_gain_db

from analyzer_sim.export import measured_dbm
from analyzer_sim.world.payload.payload import dishes_loss_db
from analyzer_sim.world.payload.user_noise import users_noise_db
from analyzer_sim.world.scenario.scenario import Scenario, scenario_named
from analyzer_sim.world.world import World

SEEDS = (1, 2, 3)
#: minutes and the published median over the links, dB
ALLAN_DB = {1: 0.113, 5: 0.075, 15: 0.083, 60: 0.099, 180: 0.112, 720: 0.110}
AUTOCORRELATION = {1: 0.75, 15: 0.56, 60: 0.43, 180: 0.29, 720: 0.06}
STD_WITHIN_DB = {10: 0.08, 60: 0.13, 360: 0.19, 1440: 0.24}


@cache
def noise_db(seed: int) -> np.ndarray:
    """Return eleven quiet days (T, N) of measured power without what attitude and dishes do to it."""
    scenario = replace(scenario_named("flicker"), quiet_h=264.0, operation_h=0.1)
    world = World(scenario, seed)
    epochs_us, attitude_deg = world.rows.epochs_us, world.rows.attitude_deg
    known_db = attitude_gain_db(world.plan, world.orbit, epochs_us, attitude_deg)
    known_db -= dishes_loss_db(world.plan, world.orbit, epochs_us, seed)
    return (measured_dbm(world) - known_db)[: 264 * 60]


def means(series: np.ndarray, minutes: int) -> np.ndarray:
    count = len(series) // minutes
    return series[: count * minutes].reshape(count, minutes, -1).mean(axis=1)


def median_over_links(figure) -> float:
    return float(np.median(np.concatenate([figure(noise_db(seed)) for seed in SEEDS])))


@pytest.mark.parametrize(("minutes", "expected_db"), ALLAN_DB.items())
def test_allan_deviation(minutes: int, expected_db: float) -> None:
    found = median_over_links(
        lambda series: np.sqrt(0.5 * np.mean(np.diff(means(series, minutes), axis=0) ** 2, axis=0))
    )
    print(f"seeds {SEEDS}: Allan deviation at {minutes} min {found:.3f} dB, published {expected_db} dB")
    assert found == pytest.approx(expected_db, rel=0.25)  # asked of the scenario


@pytest.mark.parametrize(("minutes", "expected"), AUTOCORRELATION.items())
def test_autocorrelation(minutes: int, expected: float) -> None:
    def figure(series: np.ndarray) -> np.ndarray:
        centred = series - series.mean(axis=0)
        return np.mean(centred[minutes:] * centred[:-minutes], axis=0) / np.mean(centred**2, axis=0)

    found = median_over_links(figure)
    print(f"seeds {SEEDS}: autocorrelation at {minutes} min {found:.2f}, published {expected}")
    assert found == pytest.approx(expected, abs=0.12)  # asked of the scenario


@pytest.mark.parametrize(("minutes", "expected_db"), STD_WITHIN_DB.items())
def test_spread_within_a_window(minutes: int, expected_db: float) -> None:
    def figure(series: np.ndarray) -> np.ndarray:
        count = len(series) // minutes
        return np.median(series[: count * minutes].reshape(count, minutes, -1).std(axis=1), axis=0)

    found = median_over_links(figure)
    print(f"seeds {SEEDS}: std within {minutes} min {found:.3f} dB, published {expected_db} dB")
    # 0.08 dB within ten minutes cannot be had with an Allan deviation of 0.113 dB at one minute: real links have long
    # calm and short rough stretches, a stationary noise has not
    assert found == pytest.approx(expected_db, rel=0.25 if minutes > 10 else 0.45)


def test_hourly_means_of_different_links_correlate() -> None:
    pairs = []
    for seed in SEEDS:
        matrix = np.corrcoef(means(noise_db(seed), 60).T)
        pairs.append(matrix[np.triu_indices(len(matrix), 1)])
    low, middle, high = np.percentile(np.concatenate(pairs), [5, 50, 95])
    print(f"seeds {SEEDS}: hourly means correlate {middle:.2f} ({low:.2f}..{high:.2f}), published 0.24 (-0.06..0.55)")
    assert middle == pytest.approx(0.24, abs=0.12)  # eleven days hold few independent hours of the slow parts
    assert low < 0.05
    assert high > 0.35


def test_levels_stand_on_steps() -> None:
    scenario: Scenario = replace(scenario_named("flicker"), quiet_h=6.0, operation_h=6.0)
    power = World(scenario, 1).rows.power_dbm
    steps = power / 0.15
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)  # rounding of the last bit
    assert np.unique(np.round(steps[:, 0])).size > 3  # and it moves from one to another


def test_the_solar_day_is_a_quarter_of_a_decibel() -> None:
    figures = scenario_named("flicker").noise
    scenario = replace(scenario_named("flicker"), noise=replace(figures, flicker=(), wander_scale=0.0))
    world = World(replace(scenario, quiet_h=1.0, operation_h=0.1), 1)
    day = users_noise_db(world.plan, scenario, 1, np.arange(1440) * 60.0)
    np.testing.assert_allclose(np.ptp(day, axis=0), 0.24, atol=1e-3)  # dB peak to peak


def test_harder_flicker_is_harder() -> None:
    def spread(name: str) -> float:
        world = World(replace(scenario_named(name), faults=(), quiet_h=48.0, operation_h=0.1), 1)
        return float(np.median(world.rows.power_dbm[: 48 * 60].std(axis=0)))

    plain_db, hard_db = spread("flicker"), spread("flicker_hard")
    print(f"std over two days: flicker {plain_db:.3f} dB, flicker_hard {hard_db:.3f} dB")
    assert hard_db > 1.15 * plain_db
