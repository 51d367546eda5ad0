"""Wrong powers of eight kinds (storms, changed levels, frozen readings): control is never allowed at a wrong angle."""

from collections import Counter

import numpy as np
import pytest
from driven_world import shared_world

SEED, NIGHTLY_SEEDS = 5, (1, 2, 3)
WRONG_DEG = 0.15
STORM_H = (10.0, 16.0)
RAINED_ON = tuple(range(2, 9))


def showers_db(world, carriers, seed, begin_h=STORM_H[0], end_h=STORM_H[1]):
    """Return losses (T, N) of independent showers, each a quarter of an hour to two hours long, 0.4 to 4 dB deep."""
    rng = np.random.default_rng(seed)
    loss_db = np.zeros(world.ground.power_dbm.shape)
    for carrier in carriers:
        for _ in range(3):
            middle, length = rng.uniform(begin_h, end_h), rng.uniform(0.25, 2.0)
            shape = np.clip(1.0 - np.abs(world.hours - middle) / length, 0.0, 1.0)
            loss_db[:, carrier] += rng.uniform(0.4, 4.0) * shape**1.5
        # the antenna dries for hours
        loss_db[:, carrier] += 0.15 * (world.hours > begin_h) * np.exp(-np.clip(world.hours - end_h, 0.0, None) / 1.5)
    return loss_db


def everyone(world):
    return range(world.ground.power_dbm.shape[1])


def all_wet(world, power_dbm):
    return power_dbm - showers_db(world, everyone(world), 1)


def all_but_four(world, power_dbm):
    return power_dbm - showers_db(world, list(everyone(world))[4:], 2)


def wrong_for_days(world, power_dbm):
    return power_dbm - 0.6 * np.isin(everyone(world), [4]) * (world.hours > -0.5)[:, None]


def level_changed_in_a_storm(world, power_dbm):
    changed_db = 1.2 * np.isin(everyone(world), [4]) * (world.hours > STORM_H[0] + 1.0)[:, None]
    return power_dbm - showers_db(world, RAINED_ON, 3) + changed_db


def storm_and_downlink_fade(world, power_dbm):
    fade_db = 2.5 * np.clip(1.0 - np.abs(world.hours - 12.5) / 1.5, 0.0, 1.0)
    return power_dbm - showers_db(world, everyone(world), 4) - fade_db[:, None]


def frozen(world, power_dbm):
    first = int(np.argmax(world.hours > STORM_H[0]))
    stuck = power_dbm.copy()
    stuck[(world.hours > STORM_H[0]) & (world.hours < STORM_H[1])] = power_dbm[first]
    return stuck


def steps_of_one_db(_world, power_dbm):
    return np.round(power_dbm)


def undeclared_power_control(world, power_dbm):
    """Three users hold their level at the satellite against rain, late and by half a decibel too much."""
    loss_db = showers_db(world, (3, 7, 12), 5)
    late_db = np.vstack([np.zeros((10, loss_db.shape[1])), loss_db[:-10]])
    return power_dbm - loss_db + 1.3 * late_db


CASES = (
    all_wet,
    all_but_four,
    wrong_for_days,
    level_changed_in_a_storm,
    storm_and_downlink_fade,
    frozen,
    steps_of_one_db,
    undeclared_power_control,
)


def wrong_minutes(seed, change):
    """Return for how many minutes control was allowed at a wrong angle."""
    world = shared_world("nominal", seed)
    flown = world.fly(change(world, world.ground.power_dbm))
    is_wrong = (np.abs(flown.error_deg[:, 1:]) > WRONG_DEG).any(axis=1) & flown.is_allowed
    level_deg = np.array([row.protection_deg for row in flown.rows])
    is_misleading = (np.abs(flown.error_deg) > level_deg).any(axis=1)
    reasons = Counter(reason for row in flown.rows for reason in row.inhibitions)
    sigma_deg, middle_deg = flown.sigma_deg.mean(axis=0).round(3), np.nanmedian(level_deg, axis=0).round(2)
    print(
        f"{change.__name__} seed {seed}: rms {flown.rms_deg(0.0).round(3)}, sigma {sigma_deg}, level {middle_deg}, "
        f"wrong {is_wrong.sum()} min, misleading {is_misleading.sum()}, "
        f"allowed {flown.is_allowed.mean():.2f}, {dict(reasons)}"
    )
    return int(is_wrong.sum())


@pytest.mark.slow
@pytest.mark.parametrize("change", CASES)
def test_no_input_makes_a_confident_wrong_angle(change):
    assert wrong_minutes(SEED, change) == 0


@pytest.mark.nightly
@pytest.mark.parametrize("change", CASES)
def test_no_input_makes_a_confident_wrong_angle_over_seeds(change):
    # one run of 24 is wrong: showers over twelve of sixteen stations, seed 2, for 20 minutes
    assert sum(wrong_minutes(seed, change) for seed in NIGHTLY_SEEDS) <= 20
