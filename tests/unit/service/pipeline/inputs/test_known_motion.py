"""Commanded motion: what the ground commanded reaches the filter once, in time or late."""

from itertools import pairwise

import numpy as np
import pytest
from geometry_flight import HOUR, INERTIA, LONGITUDE_DEG, MINUTE, SITE, S

from service.pipeline.inputs.known_motion import CommandedMotion, consume, heard
from service.records.catalogue import Spacecraft
from service.records.inputs import Correction
from service.records.levels.attitude import Axes
from service.records.levels.command import AppliedCommand, Pulse, ReportedCommand, TorqueCommand

CRAFT = Spacecraft("yamal-test", "Test", LONGITUDE_DEG, SITE, INERTIA, 0.05)
NAN = float("nan")
ZERO = Axes(0.0, 0.0, 0.0)
#: figures are sums of a few shares of numbers near one
EXACT = 1e-12


def command(*pulses: Pulse, epoch_us: int = 0, number: int = 7) -> AppliedCommand:
    """Return an applied command of some pulses."""
    return AppliedCommand(
        TorqueCommand(
            epoch_us=epoch_us,
            number=number,
            attitude_epoch_us=epoch_us,
            mode="ground",
            torque_n_m=ZERO,
            wheels_n_m=(0.0, 0.0, 0.0),
            saturated=False,
            command_period_s=60.0,
            valid_until_us=epoch_us + MINUTE,
            schedule=pulses,
            impulse_n_m_s=ZERO,
            predicted_angle_change_deg=ZERO,
            predicted_rate_change_deg_s=ZERO,
            predicted_wheel_momentum_n_m_s=(0.0, 0.0, 0.0),
            control_allowed=True,
            inhibitions=(),
        )
    )


def gained_deg_h(torque_n_m: float, duration_s: float, inertia_kg_m2: float) -> float:
    """Return the rate that a torque leaves."""
    return float(np.degrees(torque_n_m * duration_s / inertia_kg_m2) * 3600.0)


def walked(commanded: CommandedMotion, epochs_us: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return angle and rate (K, 3) after each row, as the filter without coupling integrates what it is told."""
    angle, rate = np.zeros(3), np.zeros(3)
    angles, rates = [], []
    for before_us, now_us in pairwise(epochs_us):
        known, commanded = consume(commanded, before_us, now_us)
        hours = (now_us - before_us) / HOUR
        angle = angle + known.correction_deg + known.late_correction_deg
        angle = angle + hours * rate + 0.5 * hours * known.rate_change_deg_h
        rate = rate + known.rate_change_deg_h
        angles.append(angle)
        rates.append(rate)
    return np.array(angles), np.array(rates)


def test_a_correction_is_spread_evenly_over_its_interval():
    reported = heard(CommandedMotion(0), Correction(2 * MINUTE, 6 * MINUTE, Axes(0.4, -0.2, NAN)), None, 0)
    angles, rates = walked(reported, [0, 1 * MINUTE, 3 * MINUTE, 5 * MINUTE, 7 * MINUTE, 9 * MINUTE])
    share = np.array([0.0, 0.25, 0.75, 1.0, 1.0])
    np.testing.assert_allclose(angles, share[:, None] * np.array([0.4, -0.2, 0.0]), atol=EXACT)
    np.testing.assert_array_equal(rates, 0.0)


def test_what_was_commanded_before_the_alignment_belongs_to_it():
    reported = heard(CommandedMotion(4 * MINUTE), Correction(0, 8 * MINUTE, Axes(0.0, 0.8, 0.0)), None, 4 * MINUTE)
    assert reported.late_deg == (0.0, 0.0, 0.0)
    # a step that begins before the alignment takes only what comes after it
    known, left = consume(reported, 2 * MINUTE, 6 * MINUTE)
    np.testing.assert_allclose(known.correction_deg, [0.0, 0.2, 0.0], atol=EXACT)
    known, left = consume(left, 6 * MINUTE, 20 * MINUTE)
    np.testing.assert_allclose(known.correction_deg, [0.0, 0.2, 0.0], atol=EXACT)
    assert left.motions == ()


def test_a_correction_that_ended_before_the_alignment_is_nothing():
    reported = heard(CommandedMotion(4 * MINUTE), Correction(0, 4 * MINUTE, Axes(0.0, 0.8, 0.0)), None, 9 * MINUTE)
    assert reported == CommandedMotion(4 * MINUTE)


def test_a_late_correction_is_applied_at_once_and_nothing_of_it_twice():
    reported = heard(CommandedMotion(0), Correction(0, 10 * MINUTE, Axes(0.1, 0.0, -1.0)), None, 4 * MINUTE)
    np.testing.assert_allclose(reported.late_deg, [0.04, 0.0, -0.4], atol=EXACT)
    known, left = consume(reported, 4 * MINUTE, 7 * MINUTE)
    np.testing.assert_allclose(known.late_correction_deg, [0.04, 0.0, -0.4], atol=EXACT)
    np.testing.assert_allclose(known.correction_deg, [0.03, 0.0, -0.3], atol=EXACT)
    assert left.late_deg == (0.0, 0.0, 0.0)
    known, left = consume(left, 7 * MINUTE, 60 * MINUTE)
    np.testing.assert_allclose(known.correction_deg + known.late_correction_deg, [0.03, 0.0, -0.3], atol=EXACT)
    assert left.motions == ()


def test_a_correction_that_is_over_when_it_becomes_known_is_late_as_a_whole():
    reported = heard(CommandedMotion(0), Correction(0, 4 * MINUTE, Axes(0.0, 0.5, 0.0)), None, 4 * MINUTE)
    assert reported.motions == ()
    np.testing.assert_allclose(reported.late_deg, [0.0, 0.5, 0.0], atol=EXACT)


@pytest.mark.parametrize("newest_us", [0, 5 * MINUTE, 20 * MINUTE])
def test_a_correction_of_an_instant_counts_once_whenever_it_becomes_known(newest_us):
    reported = heard(CommandedMotion(0), Correction(5 * MINUTE, 5 * MINUTE, Axes(0.0, 0.5, 0.0)), None, newest_us)
    angles, _ = walked(reported, [newest_us, newest_us + 10 * MINUTE, newest_us + 30 * MINUTE])
    np.testing.assert_allclose(angles[-1], [0.0, 0.5, 0.0], atol=EXACT)


def test_two_corrections_add():
    reported = CommandedMotion(0)
    for start in (0, 2):
        reported = heard(reported, Correction(start * MINUTE, 4 * MINUTE, Axes(0.1, 0.0, 0.0)), None, 0)
    angles, _ = walked(reported, [0, 2 * MINUTE, 4 * MINUTE])
    np.testing.assert_allclose(angles[:, 0], [0.05, 0.2], atol=EXACT)


def test_pulses_change_the_rate_by_torque_times_duration_over_inertia_and_the_angle_as_a_body_turns():
    pulses = (
        Pulse(90 * S, 20.0, Axes(0.0, 0.01, 0.0)),
        Pulse(110 * S, 40.0, Axes(0.002, 0.0, -0.004)),
    )
    reported = heard(CommandedMotion(0), command(*pulses), CRAFT, 0)
    epochs_us = [0, 60 * S, 95 * S, 100 * S, 180 * S, 240 * S, 3600 * S]
    angles, rates = walked(reported, epochs_us)
    # roll 2600, pitch 1400, yaw 2600 kg m2; each pulse is a constant acceleration between its ends
    gained = np.array(
        [[0.0, gained_deg_h(0.01, 20, 2600), 0.0], [gained_deg_h(0.002, 40, 2600), 0.0, gained_deg_h(-0.004, 40, 1400)]]
    )
    ends_s = np.array([[90.0, 110.0], [110.0, 150.0]])
    now_s = np.array(epochs_us[1:]) / S
    acted_s = np.clip(now_s[:, None], ends_s[:, 0], ends_s[:, 1]) - ends_s[:, 0]
    share = acted_s / (ends_s[:, 1] - ends_s[:, 0])
    after_s = np.maximum(now_s[:, None] - ends_s[:, 1], 0.0)
    turned_h = (0.5 * share * acted_s + after_s) / 3600.0
    np.testing.assert_allclose(rates, share @ gained, atol=EXACT)
    np.testing.assert_allclose(angles, turned_h @ gained, atol=EXACT)
    assert abs(angles[-1]).max() > 0.01


@pytest.mark.parametrize("known_at_s", [95, 110, 200, 900])
def test_a_pulse_that_becomes_known_late_is_caught_up_with(known_at_s):
    pulse = Pulse(90 * S, 20.0, Axes(0.0, 0.01, 0.0))
    in_time = heard(CommandedMotion(0), command(pulse), CRAFT, 0)
    late = heard(CommandedMotion(0), command(pulse), CRAFT, known_at_s * S)
    epochs_us = [known_at_s * S, known_at_s * S + 60 * S, 1200 * S, 1260 * S]
    angles, rates = walked(late, epochs_us)
    wanted, wanted_rates = walked(in_time, [0, *epochs_us[1:]])
    np.testing.assert_allclose(angles, wanted, atol=EXACT)
    np.testing.assert_allclose(rates, wanted_rates, atol=EXACT)


def test_a_pulse_without_length_and_a_command_without_a_craft_do_nothing():
    still = heard(CommandedMotion(0), command(Pulse(60 * S, 0.0, Axes(0.1, 0.1, 0.1))), CRAFT, 0)
    angles, rates = walked(still, [0, 120 * S])
    np.testing.assert_array_equal(angles, 0.0)
    np.testing.assert_array_equal(rates, 0.0)
    unknown = heard(CommandedMotion(0), command(Pulse(60 * S, 9.0, Axes(0.1, 0.1, 0.1))), None, 0)
    assert unknown == CommandedMotion(0)


# ---- commands that end one another ----------------------------------------------------------------------------------


@pytest.mark.parametrize("newest_min", [0, 5, 11], ids=["before", "within the pulse", "after the next began"])
def test_a_command_that_counts_as_applied_ends_the_pulses_of_the_one_before(newest_min):
    """Ten minutes of 1e-4 N m of which the next command leaves six; whatever rows had already consumed."""
    first = command(Pulse(2 * MINUTE, 600.0, Axes(0.0, 1e-4, 0.0)), Pulse(30 * MINUTE, 9.0, Axes(0.0, 1e-4, 0.0)))
    second = command(Pulse(20 * MINUTE, 60.0, Axes(0.0, 0.0, 1e-4)), epoch_us=8 * MINUTE, number=8)
    commanded = heard(CommandedMotion(0), first, CRAFT, 0)
    angle, rate = np.zeros(3), np.zeros(3)
    for minute in range(1, 41):
        if minute == newest_min + 1:
            commanded = heard(commanded, second, CRAFT, newest_min * MINUTE)
        known, commanded = consume(commanded, (minute - 1) * MINUTE, minute * MINUTE)
        angle = angle + known.correction_deg + known.late_correction_deg + (rate + 0.5 * known.rate_change_deg_h) / 60.0
        rate = rate + known.rate_change_deg_h
    expected = [0.0, gained_deg_h(1e-4, 360.0, INERTIA[0][0]), gained_deg_h(1e-4, 60.0, INERTIA[1][1])]
    np.testing.assert_allclose(rate, expected, rtol=EXACT)
    # each acts from the middle of its pulse on, in hours
    np.testing.assert_allclose(angle, np.array(expected) * [0.0, 35.0 / 60.0, 19.5 / 60.0], rtol=1e-9)


def test_an_older_command_and_a_report_end_nothing():
    first = command(Pulse(10 * MINUTE, 60.0, Axes(0.0, 1e-4, 0.0)), number=9)
    older = command(epoch_us=5 * MINUTE, number=8)
    report = ReportedCommand(3, 5 * MINUTE, (Pulse(6 * MINUTE, 60.0, Axes(1e-4, 0.0, 0.0)),))
    commanded = CommandedMotion(0)
    for content in (first, older, report):
        commanded = heard(commanded, content, CRAFT, 0)
    known, _ = consume(commanded, 0, 20 * MINUTE)
    expected = [gained_deg_h(1e-4, 60.0, INERTIA[2][2]), gained_deg_h(1e-4, 60.0, INERTIA[0][0]), 0.0]
    np.testing.assert_allclose(known.rate_change_deg_h, expected, rtol=EXACT)
