"""Random walk of levels: found where carriers walk, the floor where they do not."""

import numpy as np
import pytest

from service.core.estimation.calibration.level_drift import level_drift, without_common
from service.core.estimation.noise_identification import LADDER_S, IdentifiedNoise

FLOOR = 0.006
EPOCH_S = np.arange(4320) * 60.0


def white_noise(carriers, sigma_db=0.1):
    nothing = np.zeros((carriers, len(LADDER_S)))
    return IdentifiedNoise(np.full(carriers, sigma_db), nothing, np.array(LADDER_S), nothing[0])


def walks(seed, walk_db, carriers=16):
    rng = np.random.default_rng(seed)
    steps = walk_db * np.sqrt(1.0 / 60.0) * rng.normal(size=(len(EPOCH_S), carriers))
    return np.cumsum(steps, axis=0) + 0.1 * rng.normal(size=steps.shape)


def test_levels_that_stand_have_the_floor():
    found = [level_drift(walks(seed, 0.0), EPOCH_S, white_noise(16), FLOOR).walk_db for seed in range(10)]
    assert np.max(found) == FLOOR


def test_a_walk_comes_out_of_all_carriers_together():
    found = [level_drift(walks(seed, 0.03), EPOCH_S, white_noise(16), FLOOR).walk_db for seed in range(10)]
    print(f"seeds 0..9: walk {np.sqrt(np.mean(np.square(found)))} of 0.03 dB per root of hour")
    # 160 slopes: one sigma of their mean square is 11 %, of its root 6 %
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(0.03, rel=0.2)


def test_a_slope_is_told_with_what_noise_leaves():
    rng = np.random.default_rng(4)
    values = 0.1 * rng.normal(size=(len(EPOCH_S), 8))
    values[:, 3] += 0.4 * EPOCH_S / 86_400.0
    drift = level_drift(values, EPOCH_S, white_noise(8), FLOOR)
    # the median of eight follows the one that goes away only as long as it is among them
    assert drift.slope_db_per_day[3] == pytest.approx(0.4, abs=0.03)
    assert np.abs(np.delete(drift.slope_db_per_day, 3)).max() < 0.02
    # white: 0.1 sqrt(12 / 4320) / 3 d
    assert drift.sigma_db_per_day == pytest.approx(np.full(8, 0.1 * np.sqrt(12.0 / 4320.0) / 3.0), rel=0.01)


def test_what_all_do_together_is_no_walk():
    values = walks(2, 0.0) + np.cumsum(np.random.default_rng(9).normal(size=(len(EPOCH_S), 1)), axis=0) * 0.01
    assert level_drift(values, EPOCH_S, white_noise(16), FLOOR).walk_db == pytest.approx(np.full(16, FLOOR))


def test_carriers_that_are_absent_have_the_walk_of_all():
    values = walks(1, 0.03)
    values[:, 0] = np.nan
    drift = level_drift(values, EPOCH_S, white_noise(16), FLOOR)
    assert np.isnan(drift.slope_db_per_day[0])
    assert FLOOR < drift.walk_db[0] < 0.06


def test_rows_of_few_carriers_are_left_alone():
    values = np.array([[1.0, 1.0, 1.0, np.nan], [1.0, 2.0, 3.0, 2.0]])
    assert without_common(values)[0, :3] == pytest.approx(np.ones(3))
    assert without_common(values)[1] == pytest.approx([-1.0, 0.0, 1.0, 0.0])
