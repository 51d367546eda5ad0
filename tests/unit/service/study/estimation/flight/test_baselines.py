"""Answers without powers: a spacecraft that turns with the orbit, and corrections spread over their time."""

import numpy as np
import pytest

from service.records.inputs import Correction
from service.records.levels.attitude import Axes
from service.study.estimation.flight.baselines import (
    BASELINES,
    COUPLING_RAD_H,
    FEEDBACK_H,
    baseline_answers,
    commanded_deg,
)

HOUR_US = 3_600_000_000
START_US = 1_800_000_000_000_000
AT_START = np.array([0.2, -0.1, 0.05])


def epochs(hours):
    return (START_US + np.asarray(hours) * HOUR_US).astype(np.int64)


def test_names_are_those_of_the_table():
    assert tuple(baseline_answers(epochs([1.0]), START_US, AT_START, ())) == BASELINES


def test_without_corrections_a_quarter_of_a_day_turns_yaw_into_roll():
    quarter_h = 0.5 * np.pi / COUPLING_RAD_H
    answers = baseline_answers(epochs(np.linspace(0.01, quarter_h, 300)), START_US, AT_START, ())
    yaw, roll, pitch = AT_START
    # roll' = w yaw, yaw' = -w roll; the last epoch is rounded to a microsecond
    assert answers["coupling"][-1] == pytest.approx([-roll, yaw, pitch], abs=1e-9)
    assert answers["corrections"] == pytest.approx(np.tile(AT_START, (300, 1)), abs=0.0)
    assert not answers["zero"].any()


def test_a_correction_is_spread_evenly_over_its_interval():
    correction = Correction(START_US + HOUR_US, START_US + 3 * HOUR_US, Axes(0.4, 0.0, -0.2))
    reported = commanded_deg(epochs([0.5, 1.0, 2.0, 3.0, 9.0]), (correction,))
    assert reported[:, 0] == pytest.approx([0.0, 0.0, 0.2, 0.4, 0.4], abs=1e-12)
    assert reported[:, 2] == pytest.approx([0.0, 0.0, -0.1, -0.2, -0.2], abs=1e-12)


def test_what_was_commanded_before_the_alignment_is_in_its_attitude():
    early = Correction(START_US - HOUR_US, START_US + HOUR_US, Axes(0.0, 0.2, 0.0))
    answers = baseline_answers(epochs([0.5, 2.0]), START_US, np.zeros(3), (early,))
    assert answers["corrections"][:, 1] == pytest.approx([0.05, 0.1], abs=1e-12)


def test_pitch_does_not_couple():
    nod = Correction(START_US, START_US + HOUR_US, Axes(0.0, 0.0, 0.3))
    answers = baseline_answers(epochs(np.linspace(0.1, 5.0, 50)), START_US, np.zeros(3), (nod,))
    assert answers["coupling"][:, :2] == pytest.approx(np.zeros((50, 2)), abs=0.0)
    assert answers["coupling"][-1, 2] == pytest.approx(0.3, abs=1e-12)


def test_corrections_against_the_exchange_hold_the_craft_still():
    """Told to hold 0.1 deg of roll, the ground takes out what the exchange would bring."""
    hold = Correction(START_US, START_US + 2 * HOUR_US, Axes(2.0 * COUPLING_RAD_H * 0.1, 0.0, 0.0))
    answers = baseline_answers(epochs(np.arange(1, 121) / 60.0), START_US, np.array([0.0, 0.1, 0.0]), (hold,))
    # a minute's rotation with its correction in the middle: exact but for the third power of 0.004 rad
    assert answers["coupling"][-1] == pytest.approx([0.0, 0.1, 0.0], abs=1e-5)


def test_a_correction_read_as_a_measurement_tells_what_its_operator_saw():
    seen = np.array([0.06, -0.04, 0.02])
    share = -np.expm1(-0.5 / FEEDBACK_H)
    change = -share * seen
    correction = Correction(START_US + HOUR_US, START_US + 3 * HOUR_US // 2, Axes(*change.tolist()))
    answers = baseline_answers(epochs([0.5, 1.0, 1.5]), START_US, AT_START, (correction,))["corrections_read"]
    np.testing.assert_allclose(answers[0], AT_START)
    np.testing.assert_allclose(answers[1], seen, atol=1e-12)  # rounding
    angle = 0.5 * COUPLING_RAD_H
    yaw, roll, pitch = seen
    turned = [np.cos(angle) * yaw - np.sin(angle) * roll, np.sin(angle) * yaw + np.cos(angle) * roll, pitch]
    np.testing.assert_allclose(answers[2], turned + change, atol=1e-12)  # rounding


def test_without_corrections_nothing_can_be_read():
    answers = baseline_answers(epochs([0.5, 1.0]), START_US, AT_START, ())["corrections_read"]
    np.testing.assert_allclose(answers, [AT_START, AT_START])
