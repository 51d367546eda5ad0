"""Trials of the snapshot put together: ratios, the scale of yaw, and where it breaks down."""

import numpy as np
import pytest

from service.study.estimation.trials.snapshot_trials import SnapshotTrials, trial_statistics


def trials(far=(0, 0, 0, 0, 0, 0, 0, 40), square=1.0, covariance=1.0, excluded=0.0):
    count = len(far)
    return SnapshotTrials(
        np.full(3, square),
        np.array([1.0, 1.21, 1.44]),
        covariance,
        1.0,
        np.full(count, 100.0),
        np.array(far, dtype=float),
        np.full(count, 1000.0),
        np.full(count, excluded),
        np.array([0.0004, -0.0001]),
    )


def test_ratios_are_pooled_as_squares():
    found = trial_statistics([trials(square=1.0), trials(square=3.0)])
    assert found["over_bound_true.yaw"] == pytest.approx(np.sqrt(2.0))
    assert [found[f"over_bound_fitted.{axis}"] for axis in ("yaw", "roll", "pitch")] == pytest.approx([1.0, 1.1, 1.2])


def test_the_yaw_scale_is_pooled():
    assert trial_statistics([trials(covariance=0.9), trials(covariance=1.2)])["yaw_scale"] == pytest.approx(1.05)


@pytest.mark.parametrize(
    ("far", "breakdown"),
    [((0, 0, 0, 0, 0, 0, 0, 40), 6), ((0, 0, 5, 0, 0, 0, 0, 0), 1), ((0,) * 8, 7), ((1,) * 8, -1)],
)
def test_the_breakdown_is_the_last_number_up_to_which_all_is_well(far, breakdown):
    # one far fix of a hundred is 1 %, which is too many
    assert trial_statistics([trials(far=far)])["breakdown"] == breakdown


def test_exclusions_are_counted_up_to_the_breakdown():
    found = trial_statistics([trials(excluded=2.0)])
    assert found["false_exclusion_share"] == pytest.approx(0.002)


def test_the_error_of_the_level_is_pooled_and_never_below_nothing():
    found = trial_statistics([trials(), trials()])
    assert (found["level_day1_db"], found["level_day7_db"]) == (pytest.approx(0.02), 0.0)
