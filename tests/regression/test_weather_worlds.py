"""Worlds with the weather of real links: never confident and wrong.

Bounds are those of ten seeds (`soo study estimation --group yardstick`); a seed alone has room. Seed 6 of
`weather_far` was wrong for 791 minutes with control allowed before there was an anchor, at 2.9 of its sigma in roll.
"""

import numpy as np
import pytest

from service.study.estimation.unit import Unit, run_unit

RELEARNED = ("weather_far", 6)
NIGHTLY = (("weather_far", 2), ("weather_far", 8), ("weather_near", 5), ("weather_near", 7), ("weather_alignment", 1))


def assert_honest(scenario, seed):
    yardsticks = run_unit(Unit(scenario, seed)).yardsticks
    for name, one in yardsticks.items():
        level = one.protection
        told = "" if level is None else f", misleading {level.misleading_share:.4f} in {level.episodes}"
        print(
            f"{scenario} seed {seed} {name}: wrong {one.wrong_min:.0f} min, dry {one.allowed_dry:.3f}, "
            f"rms {np.round(one.rms_deg, 3)}, rms/sigma {np.round(one.rms_over_sigma, 2)}{told}"
        )
    robust = yardsticks["robust"]
    assert robust.wrong_min <= 40.0
    assert robust.protection.misleading_share <= 0.01
    assert robust.protection.without_share < 0.05
    assert robust.allowed_dry >= 0.75
    assert (robust.rms_over_sigma[1:] < 2.2).all()
    # the trivial answers fail where the method passes
    assert yardsticks["never allow"].allowed_dry == 0.0
    return yardsticks


@pytest.mark.nightly
@pytest.mark.slow
def test_rain_teaches_no_wrong_angle():
    yardsticks = assert_honest(*RELEARNED)
    assert yardsticks["robust"].wrong_min == 0.0
    assert yardsticks["robust"].protection.episodes == 0
    assert yardsticks["three sigma"].protection.misleading_share > 0.001


@pytest.mark.nightly
@pytest.mark.parametrize(("scenario", "seed"), NIGHTLY)
def test_rain_teaches_no_wrong_angle_over_worlds(scenario, seed):
    assert_honest(scenario, seed)
