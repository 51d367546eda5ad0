"""The presence test never lets noise pass as a level."""

import numpy as np
import pytest

from service.core.radio.presence import HYSTERESIS_DB, initial_presence, presence_threshold_db, step_presence

THRESHOLD = np.array([2.0])


def run(ratios: list[float]) -> tuple[list[bool], list[bool]]:
    """Return visibility and state after each ratio."""
    state, visible, present = initial_presence(1), [], []
    for ratio in ratios:
        state, shown = step_presence(state, np.array([ratio]), THRESHOLD)
        visible.append(bool(shown[0]))
        present.append(bool(state.is_present[0]))
    return visible, present


def test_a_start_on_a_present_carrier_loses_no_row() -> None:
    assert run([10.0, 10.0])[0] == [True, True]


def test_an_absent_carrier_appears_after_three_of_five() -> None:
    assert run([0.0, 10.0, 0.0, 10.0, 10.0])[0] == [False, False, False, False, True]


def test_appearing_needs_the_hysteresis() -> None:
    just_below = float(THRESHOLD[0]) + HYSTERESIS_DB - 0.01
    assert not any(run([0.0, *[just_below] * 6])[0])


def test_staying_needs_only_the_threshold() -> None:
    assert all(run([10.0, *[float(THRESHOLD[0]) + 0.01] * 6])[0])


def test_a_lost_carrier_is_hidden_at_once_and_absent_after_three() -> None:
    visible, present = run([10.0, 0.0, 0.0, 0.0])
    assert visible == [True, False, False, False]
    assert present == [True, True, True, False]


def test_a_single_dropout_costs_one_row() -> None:
    assert run([10.0] * 5 + [0.0] + [10.0] * 3)[0] == [True] * 5 + [False] + [True] * 3


def test_an_unmeasured_sweep_casts_no_vote() -> None:
    visible, present = run([10.0, *[float("nan")] * 6, 10.0])
    assert visible == [True, *[False] * 6, True]
    assert all(present)


def test_false_alarms_of_pure_noise_are_rare() -> None:
    rng = np.random.default_rng(11)
    n_carrier, n_noise = 400.0, 800.0
    inside = rng.gamma(n_carrier, 1 / n_carrier, 200_000)
    beside = rng.gamma(n_noise, 1 / n_noise, 200_000)
    threshold = float(presence_threshold_db(n_carrier, n_noise))
    # one in a million expected of a normal ratio; the gamma's skewness may add a few in 200 000
    assert int(np.sum(10 * np.log10(inside / beside) > threshold)) <= 4


def test_the_threshold_has_a_floor() -> None:
    assert float(presence_threshold_db(1e9, 1e9)) == pytest.approx(1.0, abs=1e-12)  # exact by definition
