"""Slews as pairs of pulses: exact in the angle, no rate left, quantum and grid kept; the envelope refuses the rest."""

import numpy as np
import pytest

from service.core.control.envelope import Envelope, envelope_excesses
from service.core.control.slew_schedule import AxisPulse, Drive, plan_slew, predicted_effect

INERTIA = np.diag([2600.0, 2600.0, 1400.0])
DRIVE = Drive(0.05, 0.002, 0.1, 0.001)
NOTHING = (0.0, 0.0, 0.0)


def effect_of(pulses, horizon_s=900.0):
    return predicted_effect(pulses, INERTIA, np.eye(3), horizon_s)


def test_each_slew_carries_the_pulse_that_nulls_its_rate():
    pulses = plan_slew([0.0, 0.08, 0.0], NOTHING, INERTIA, 900.0, DRIVE)
    first, second = pulses
    assert first.torque_n_m == -second.torque_n_m == 0.002
    assert first.duration_s == second.duration_s
    found = effect_of(pulses)
    assert found.angle_change_deg[1] == pytest.approx(0.08, rel=1e-12)
    assert found.rate_change_deg_s == NOTHING
    assert found.impulse_n_m_s == NOTHING
    assert found.gross_impulse_n_m_s[1] == pytest.approx(2.0 * 0.002 * first.duration_s)


def test_a_rate_alone_is_taken_by_one_pulse_at_once():
    pulses = plan_slew(NOTHING, [0.0, 2e-5, 0.0], INERTIA, 900.0, DRIVE)
    assert [(pulse.axis, pulse.start_s) for pulse in pulses] == [(1, 0.0)]
    # one tick of one quantum: 2e-6 N m s of 2600 kg m^2
    assert effect_of(pulses).rate_change_deg_s[1] == pytest.approx(-2e-5, abs=5e-8)


def test_a_wish_below_the_shortest_pulse_is_left_out():
    assert plan_slew([0.0, 1e-4, 0.0], NOTHING, INERTIA, 900.0, DRIVE) == ()


def test_a_slew_without_time_is_refused():
    with pytest.raises(ValueError, match="allow the slew more time"):
        plan_slew([0.0, 5.0, 0.0], NOTHING, INERTIA, 60.0, DRIVE)


@pytest.mark.parametrize(
    ("drive", "horizon_s", "message"),
    [
        (Drive(0.001, 0.002, 0.1, 0.001), 900.0, "quantum"),
        (Drive(0.05, 0.002, 0.1, 0.0), 900.0, "positive"),
        (DRIVE, 0.2, "no room"),
        (DRIVE, float("nan"), "finite"),
    ],
)
def test_a_drive_that_cannot_is_refused(drive, horizon_s, message):
    with pytest.raises(ValueError, match=message):
        plan_slew([0.0, 0.1, 0.0], NOTHING, INERTIA, horizon_s, drive)


@pytest.mark.parametrize("wanted", [[0.0, float("nan"), 0.0], [0.1, 0.1]])
def test_a_wish_that_is_no_angle_is_refused(wanted):
    with pytest.raises(ValueError, match="three finite"):
        plan_slew(wanted, NOTHING, INERTIA, 900.0, DRIVE)


def test_the_way_counts_as_well_as_the_end():
    """Out and back: no angle is left, but it was there."""
    turns = ((0.0, 0.01), (400.0, -0.02), (800.0, 0.01))
    pulses = tuple(AxisPulse(1, start_s, 2.0, torque) for start_s, torque in turns)
    found = effect_of(pulses)
    assert found.angle_change_deg[1] == pytest.approx(0.0, abs=1e-12)
    # 0.02 N m s of 2600 kg m^2 for 400 s, less a quarter of the pulse in whose middle the spacecraft turns back
    assert found.peak_angle_deg[1] == pytest.approx(np.degrees(0.02 / 2600.0 * 399.5), rel=1e-9)
    quantities = [each.quantity for each in envelope_excesses(found, NOTHING, Envelope())]
    assert quantities == ["angle_change_deg", "rate_change_deg_s", "impulse_n_m_s"]


def test_an_angle_that_turns_back_inside_a_pulse_is_found():
    found = predicted_effect((AxisPulse(1, 0.0, 10.0, 0.01), AxisPulse(1, 10.0, 30.0, -0.01)), INERTIA, np.eye(3), 40.0)
    # v^2/a with v = a * 10 s: half of it on the way up, half until it stands
    assert found.peak_angle_deg[1] == pytest.approx(-np.degrees(0.01 / 2600.0 * 100.0), rel=1e-12)
    assert found.angle_change_deg[1] == pytest.approx(-np.degrees(0.01 / 2600.0 * 100.0), rel=1e-12)


@pytest.mark.parametrize(
    ("pulses", "message"),
    [
        ((AxisPulse(0, 0.0, 5.0, 0.01), AxisPulse(0, 4.0, 1.0, 0.01)), "about yaw overlap"),
        ((AxisPulse(0, 899.0, 5.0, 0.01),), "after the horizon"),
        ((AxisPulse(0, -1.0, 5.0, 0.01),), "before the schedule"),
        ((AxisPulse(0, 0.0, float("nan"), 0.01),), "finite"),
    ],
)
def test_schedules_that_make_no_sense_are_refused(pulses, message):
    with pytest.raises(ValueError, match=message):
        effect_of(pulses)


def test_pulses_of_different_axes_may_overlap():
    effect_of((AxisPulse(0, 0.0, 5.0, 0.01), AxisPulse(2, 4.0, 1.0, 0.01)))


def test_what_was_sent_within_the_hour_counts():
    found = effect_of(plan_slew([0.0, 0.08, 0.0], NOTHING, INERTIA, 900.0, DRIVE))
    assert envelope_excesses(found, (0.0, 0.085, 0.0), Envelope()) == ()
    (excess,) = envelope_excesses(found, (0.0, 0.095, 0.0), Envelope())
    assert str(excess).startswith("roll impulse_an_hour_n_m_s 0.1")


def test_what_is_no_number_is_beyond_every_limit():
    found = effect_of(plan_slew([0.0, 0.02, 0.0], NOTHING, INERTIA, 900.0, DRIVE))
    broken = found._replace(peak_angle_deg=(0.0, float("nan"), 0.0))
    assert [each.quantity for each in envelope_excesses(broken, NOTHING, Envelope())] == ["angle_change_deg"]


def test_an_envelope_is_compared_limit_by_limit():
    assert Envelope(angle_change_deg=0.05).is_within(Envelope())
    assert not Envelope(angle_change_deg=0.2).is_within(Envelope())
    assert not Envelope(impulse_n_m_s=0.0).is_within(Envelope())
    assert not Envelope(impulse_n_m_s=float("nan")).is_within(Envelope())
