"""Claims about the axis-selective choice of carriers."""

import numpy as np
import pytest

from service.core.estimation.observability import condition_number, crlb_deg
from service.core.estimation.paper.selection import SelectionReason, axis_dominance, axis_margin, select_by_axis

RNG = np.random.default_rng(29)
SYMMETRIC = RNG.normal(0.0, [0.16, 1.4, 1.2], (40, 3))
ALL = np.ones(40, dtype=bool)


def test_axes_take_turns_roll_pitch_yaw():
    selection = select_by_axis(SYMMETRIC, ALL, 9)
    assert selection.axis[selection.chosen].tolist() == [1, 2, 0] * 3


def test_each_turn_takes_the_carrier_of_largest_margin_left():
    selection = select_by_axis(SYMMETRIC, ALL, 15)
    margin, dominance = axis_margin(SYMMETRIC), axis_dominance(SYMMETRIC)
    is_free = ALL.copy()
    for carrier in selection.chosen:
        axis = selection.axis[carrier]
        assert margin[carrier, axis] == margin[is_free, axis].max()
        assert selection.dominance[carrier] == dominance[carrier, axis]
        is_free[carrier] = False


def test_every_carrier_has_a_reason():
    symmetric, eligible = SYMMETRIC.copy(), ALL.copy()
    symmetric[3, 0], eligible[[3, 5, 6]] = np.nan, False
    selection = select_by_axis(symmetric, eligible, 12)
    assert selection.reason[3] == SelectionReason.NOT_MEASURED
    assert selection.axis[3] == -1
    assert np.isnan(selection.dominance[3])
    assert selection.reason[[5, 6]].tolist() == [SelectionReason.NOT_ELIGIBLE] * 2
    assert (selection.reason == SelectionReason.CHOSEN).sum() == 12
    assert (selection.reason == SelectionReason.NOT_NEEDED).sum() == 25
    assert selection.rank[selection.chosen].tolist() == list(range(12))
    assert (selection.rank >= 0).sum() == 12


def test_those_not_chosen_keep_the_axis_they_feel_most():
    selection = select_by_axis(SYMMETRIC, ALL, 0)
    assert selection.chosen.size == 0
    assert np.array_equal(selection.axis, np.argmax(np.abs(SYMMETRIC) * [8.0, 1.0, 1.0], axis=1))


def test_more_than_there_are_gives_all_eligible():
    eligible = ALL.copy()
    eligible[::2] = False
    assert sorted(select_by_axis(SYMMETRIC, eligible, 99).chosen) == np.flatnonzero(eligible).tolist()


def test_figures_are_those_of_the_chosen():
    selection = select_by_axis(SYMMETRIC, ALL, 16)
    assert selection.condition == condition_number(SYMMETRIC[selection.chosen])


def test_it_beats_a_random_choice_on_every_axis():
    ratios = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        azimuth, elevation = np.radians(rng.uniform(-5.2, 5.0, 40)), np.radians(rng.uniform(6.3, 8.5, 40))
        slope_x, slope_y = rng.normal(0.0, 1.2, 40), rng.normal(0.0, 1.4, 40)
        sensitivity = np.stack([-slope_x * elevation + slope_y * azimuth, -slope_y, -slope_x], axis=1)
        bounds_deg = [
            crlb_deg(sensitivity[chosen], np.full(8, 0.1857), with_common=True)
            for chosen in [select_by_axis(sensitivity, ALL, 8).chosen]
            + [rng.choice(40, 8, replace=False) for _ in range(9)]
        ]
        ratios.append(bounds_deg[0] / np.median(bounds_deg[1:], axis=0))
    assert np.all(np.median(ratios, axis=0) < 0.8)  # measured 0.62, 0.64, 0.65


def test_the_choice_follows_the_carriers_not_their_order():
    order = RNG.permutation(40)
    shuffled = select_by_axis(SYMMETRIC[order], ALL, 12)
    assert np.array_equal(order[shuffled.chosen], select_by_axis(SYMMETRIC, ALL, 12).chosen)


def test_of_equal_dominance_the_stronger_wins_and_of_equals_the_first():
    symmetric = np.array([[0.0, 1.0, 0.5], [0.0, 2.0, 1.0], [0.0, 2.0, 1.0]])
    assert select_by_axis(symmetric, np.ones(3, dtype=bool), 1).chosen.tolist() == [1]


def test_a_carrier_of_one_axis_alone_dominates_without_limit():
    dominance = axis_dominance(np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 0.0]]))
    assert dominance.tolist() == [[0.0, np.inf, 0.0], [0.0, 0.0, 0.0]]


@pytest.mark.parametrize(("yaw_scale", "axis"), [(1.0, 1), (10.0, 0)])
def test_yaw_is_scaled_before_axes_are_compared(yaw_scale, axis):
    selection = select_by_axis(np.array([[0.2, 1.0, 0.0]]), np.zeros(1, dtype=bool), 1, yaw_scale=yaw_scale)
    assert selection.axis[0] == axis
