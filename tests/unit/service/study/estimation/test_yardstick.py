"""Yardstick of integrity: minutes, shares and episodes of answers whose errors are chosen."""

from dataclasses import replace

import numpy as np
import pytest

from service.study.estimation.campaign import CampaignPlan, assess, collect_metrics
from service.study.estimation.report import tables
from service.study.estimation.yardstick import (
    dry_rows,
    measure_yardstick,
    measure_yardsticks,
    yardstick_statistics,
)

ROWS = 3000


@pytest.fixture
def erring(toured_world, said):
    """Return the truth with 20 min of 0.2 deg in roll, 10 of them later by seven hours, and 0.5 deg in yaw once."""
    estimate = toured_world.truth.attitude_deg.copy()
    estimate[100:110, 1] += 0.2
    estimate[530:540, 1] += 0.2
    estimate[2000, 0] += 0.5
    return said(estimate)


def test_wrong_torque_counts_roll_and_pitch_while_control_is_allowed(toured_world, driven_world, erring):
    driven = driven_world({"robust": erring})
    assert measure_yardstick(toured_world, driven, erring).wrong_min == 20.0
    allowed = np.ones(ROWS, dtype=bool)
    allowed[105:110] = False
    assert measure_yardstick(toured_world, driven, replace(erring, is_control_allowed=allowed)).wrong_min == 15.0


def test_the_first_hour_counts(toured_world, driven_world, said):
    estimate = toured_world.truth.attitude_deg.copy()
    estimate[:10, 2] += 0.16
    series = said(estimate)
    assert measure_yardstick(toured_world, driven_world({"robust": series}), series).wrong_min == 10.0


def test_rms_stands_beside_the_stated_sigma(toured_world, driven_world, said):
    series = said(toured_world.truth.attitude_deg + np.array([0.04, 0.02, 0.01]), sigma_deg=0.02)
    found = measure_yardstick(toured_world, driven_world({"robust": series}), series)
    np.testing.assert_allclose(found.rms_deg, [0.04, 0.02, 0.01], atol=1e-12)  # rounding
    np.testing.assert_allclose(found.rms_over_sigma, [2.0, 1.0, 0.5], atol=1e-9)  # rounding


def test_misleading_rows_closer_than_six_hours_are_one_episode(toured_world, driven_world, erring):
    level = np.full((ROWS, 3), 0.1)
    driven = driven_world({"robust": erring})
    protection = measure_yardstick(toured_world, driven, replace(erring, protection_deg=level)).protection
    assert protection is not None
    assert (protection.misleading_share, protection.episodes) == (21 / ROWS, 3)
    level[:, 0] = 0.6
    level[530:540] = np.nan
    protection = measure_yardstick(toured_world, driven, replace(erring, protection_deg=level)).protection
    assert protection is not None
    assert (protection.misleading_share, protection.episodes, protection.without_share) == (10 / ROWS, 1, 10 / ROWS)
    np.testing.assert_allclose(protection.median_dry_deg, 0.1)


def test_a_row_is_dry_while_fewer_than_two_stations_are_wet(toured_world, said, driven_world):
    loss = np.zeros((ROWS, 4))
    loss[:600, 0] = 0.31
    loss[300:600, 1] = 0.31
    loss[600:900] = 0.29
    truth = replace(toured_world.truth, station_loss_db=loss)
    assert (~dry_rows(truth)).nonzero()[0].tolist() == list(range(300, 600))
    # two carriers of one station are one station
    assert dry_rows(replace(truth, stations=("s0", "s0", "s2", "s3"))).all()
    allowed = np.zeros(ROWS, dtype=bool)
    allowed[600:1140] = True
    world = toured_world._replace(truth=truth)
    series = said(truth.attitude_deg, is_control_allowed=allowed)
    assert measure_yardstick(world, driven_world({"robust": series}), series).allowed_dry == 540 / 2700


def test_trivial_answers_stand_beside_the_method(toured_world, driven_world, erring):
    allowed = np.ones(ROWS, dtype=bool)
    allowed[100:110] = False
    series = replace(erring, is_control_allowed=allowed)
    found = measure_yardsticks(toured_world, driven_world({"robust": series}), "robust")
    assert {name: (one.wrong_min, one.allowed_dry) for name, one in found.items()} == {
        "robust": (10.0, (ROWS - 10) / ROWS),
        "never allow": (0.0, 0.0),
        "always allow": (20.0, 1.0),
        "three sigma": (10.0, (ROWS - 10) / ROWS),
    }
    # errors of 0.2 and 0.5 deg at a sigma of 0.02
    assert found["three sigma"].protection is not None
    assert found["three sigma"].protection.episodes == 3
    assert measure_yardsticks(toured_world, driven_world({"robust": series}), "paper") == {}


def test_means_and_the_worst_seed(toured_world, driven_world, erring, said):
    right = said(toured_world.truth.attitude_deg)
    seeds = {
        seed: measure_yardsticks(toured_world, driven_world({"robust": series}), "robust")["three sigma"]
        for seed, series in ((4, right), (7, erring))
    }
    figures = yardstick_statistics(seeds)
    assert [figures[f"yardstick.wrong_min{end}"] for end in ("", ".worst", ".worst_seed")] == [10.0, 20.0, 7.0]
    assert (figures["yardstick.episodes"], figures["yardstick.misleading_share"]) == (3.0, 10.5 / ROWS)
    assert figures["yardstick.level_deg.roll"] == pytest.approx(0.06)


def test_the_table_has_a_row_for_each_answer(judged_unit, toured_world, driven_world, erring):
    yardsticks = measure_yardsticks(toured_world, driven_world({"robust": erring}), "robust")
    results = [replace(judged_unit(seed=seed), yardsticks=yardsticks) for seed in (1, 2)]
    campaign = assess(CampaignPlan(("octants",), 2), 1.0, tuple(results), collect_metrics(results))
    reported = {table.title.partition(":")[0]: table for table in tables(campaign)}
    wrong = {row[1]: row[2] for row in reported["Confident and wrong"].rows}
    assert wrong == {
        "robust": "20; 20 (1)",
        "never allow": "0; 0 (1)",
        "always allow": "20; 20 (1)",
        "three sigma": "20; 20 (1)",
    }
    # only one of them states a level
    assert [row[1:4] for row in reported["Protection levels"].rows] == [("three sigma", "0.0070; 0.0070 (1)", "6")]
    # what only the yardstick measures is no answer of the other tables
    assert {row[1] for row in tables(campaign)[0].rows} == {"robust", "paper"}
