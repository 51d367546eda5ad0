"""Claims about the node phase."""

import math

import numpy as np
import pytest

from service.core.geometry.node_phase import latest_node_us, node_phase_at_rad, node_phase_rad

PERIOD_S = 86_328.0  # 23.98 h, the paper's
PERIOD_US = 86_328_000_000
NODES_US = np.array([1_000_000, 1_000_000 + PERIOD_US, 1_000_000 + 2 * PERIOD_US])


def test_a_node_is_its_own_latest_node():
    assert latest_node_us(NODES_US, NODES_US, PERIOD_S).tolist() == NODES_US.tolist()


def test_one_microsecond_before_a_node_belongs_to_the_node_before():
    assert latest_node_us(NODES_US[1:] - 1, NODES_US, PERIOD_S).tolist() == NODES_US[:-1].tolist()


def test_nodes_are_extrapolated_by_whole_periods_on_both_sides():
    epoch_us = np.array([NODES_US[0] - 1, NODES_US[0] - PERIOD_US - 1, NODES_US[-1] + 5 * PERIOD_US + 7])
    expected = [NODES_US[0] - PERIOD_US, NODES_US[0] - 2 * PERIOD_US, NODES_US[-1] + 5 * PERIOD_US]
    assert latest_node_us(epoch_us, NODES_US, PERIOD_S).tolist() == expected


def test_order_of_the_nodes_does_not_matter():
    epoch_us = np.arange(-2, 6) * (PERIOD_US // 2)
    shuffled = latest_node_us(epoch_us, NODES_US[[2, 0, 1]], PERIOD_S)
    assert shuffled.tolist() == latest_node_us(epoch_us, NODES_US, PERIOD_S).tolist()


def test_a_listed_node_that_comes_late_is_not_anticipated():
    late_us = NODES_US[0] + PERIOD_US + 60_000_000
    epoch_us = np.array([late_us - 1, late_us])
    nodes_us = np.array([NODES_US[0], late_us])
    assert latest_node_us(epoch_us, nodes_us, PERIOD_S).tolist() == [NODES_US[0], late_us]


def test_the_phase_stays_below_one_turn_when_a_node_comes_late():
    nodes_us = np.array([0, PERIOD_US + 60_000_000])
    phase_rad = node_phase_rad(np.array([PERIOD_US, PERIOD_US + 30_000_000]), nodes_us, PERIOD_S)
    # 30 s of 23.98 h is 2.2e-3 rad; float64 keeps 1e-12 of it
    np.testing.assert_allclose(phase_rad, [0.0, 2.0 * math.pi * 30.0 / PERIOD_S], rtol=0.0, atol=1e-12)


def test_a_hole_in_the_list_is_bridged_by_whole_periods():
    nodes_us = NODES_US[[0, 2]]
    assert latest_node_us(NODES_US[1:2] + 5, nodes_us, PERIOD_S).tolist() == [NODES_US[1]]


@pytest.mark.parametrize("periods", [-400, -1, 1, 3, 1000])
def test_shifting_epochs_and_nodes_by_whole_periods_changes_nothing(periods):
    epoch_us = np.arange(0, 3 * PERIOD_US, 7_777_777_777)
    shifted = node_phase_rad(epoch_us + periods * PERIOD_US, NODES_US + periods * PERIOD_US, PERIOD_S)
    # integers throughout: equal bit for bit
    assert np.array_equal(shifted, node_phase_rad(epoch_us, NODES_US, PERIOD_S))


def test_shifting_epochs_alone_by_whole_periods_changes_nothing():
    epoch_us = NODES_US[-1] + np.arange(0, PERIOD_US, 777_777_777)
    shifted = node_phase_rad(epoch_us + 37 * PERIOD_US, NODES_US, PERIOD_S)
    assert np.array_equal(shifted, node_phase_rad(epoch_us, NODES_US, PERIOD_S))


def test_the_phase_covers_the_turn_and_never_reaches_it():
    phase_rad = node_phase_rad(np.array([0, PERIOD_US // 4, PERIOD_US - 1]), np.array([0]), PERIOD_S)
    np.testing.assert_allclose(phase_rad[:2], [0.0, math.pi / 2.0], rtol=0.0, atol=1e-12)  # rounding of float64
    assert math.pi < phase_rad[2] < 2.0 * math.pi


@pytest.mark.parametrize("period_s", [0.0, -1.0, math.nan, math.inf])
def test_without_a_usable_period_the_phase_is_absent_and_a_node_is_an_error(period_s):
    assert np.isnan(node_phase_rad(NODES_US, NODES_US, period_s)).all()
    assert math.isnan(node_phase_at_rad(0, (0,), period_s))
    with pytest.raises(ValueError, match="period"):
        latest_node_us(NODES_US, NODES_US, period_s)


def test_without_nodes_the_phase_is_absent_and_a_node_is_an_error():
    none = np.array([], dtype=np.int64)
    assert np.isnan(node_phase_rad(NODES_US, none, PERIOD_S)).all()
    assert math.isnan(node_phase_at_rad(0, (), PERIOD_S))
    with pytest.raises(ValueError, match="listed node"):
        latest_node_us(NODES_US, none, PERIOD_S)
