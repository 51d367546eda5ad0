"""Torque commands: zero with reasons, pulses inside their period, and what they are predicted to do."""

from dataclasses import replace

import numpy as np
import pytest

from service.pipeline.config import TorqueConfig
from service.pipeline.wheel_torques import CONTROL_INHIBITIONS, NO_CARRY, compute_command, control_inhibitions
from service.records.attitude import Axes, row_without_attitude
from service.records.catalogue import ControlMode, Method, Onboard, WheelSet

S = 1_000_000
EPOCH = 1_800_000_000 * S
ZERO = Axes(0.0, 0.0, 0.0)
PERIOD_S = 60.0


def row(attitude=(0.3, 0.4, -0.3), rates=(1e-6, -2e-6, 1e-6), allowed=(True, True, True), **changes):
    plain = row_without_attitude(EPOCH, EPOCH + 3 * S, 77, Method.PAPER, ())
    return replace(
        plain,
        attitude_deg=Axes(*attitude),
        rates_deg_s=None if rates is None else Axes(*rates),
        control_allowed=True,
        control_allowed_axes=allowed,
        **changes,
    )


def command(of, craft, carry=NO_CARRY, period_s=PERIOD_S):
    return compute_command(of, craft, carry, period_s, TorqueConfig())


@pytest.fixture
def craft(payload):
    """A simulated spacecraft under ground control."""
    return payload.spacecraft()


def test_a_command_opposes_angles_and_says_when_it_ends(craft):
    outcome = command(row(), craft)
    found = outcome.command
    assert found.torque_n_m.yaw < 0.0
    assert found.torque_n_m.roll < 0.0
    assert found.torque_n_m.pitch > 0.0
    assert (found.control_allowed, found.inhibitions, found.saturated) == (True, (), False)
    assert (found.epoch_us, found.attitude_epoch_us, found.number) == (EPOCH, EPOCH, 77)
    assert found.valid_until_us == EPOCH + 60 * S
    # wheels on the body axes x roll, y pitch, z yaw turn against the body
    expected = [-found.torque_n_m.roll, -found.torque_n_m.pitch, -found.torque_n_m.yaw]
    np.testing.assert_allclose(found.wheels_n_m, expected, rtol=1e-12)  # rounding of a pseudo-inverse
    np.testing.assert_allclose(found.predicted_wheel_momentum_n_m_s, np.array(expected) * PERIOD_S, rtol=1e-12)


def test_the_mean_torque_is_the_impulse_over_the_period_and_the_pulses_lie_inside_it(craft):
    found = command(row(), craft).command
    np.testing.assert_allclose(np.array(found.torque_n_m) * PERIOD_S, found.impulse_n_m_s, rtol=1e-12)
    total = sum(np.array(pulse.torque_n_m) * pulse.duration_s for pulse in found.schedule)
    np.testing.assert_allclose(total, found.impulse_n_m_s, rtol=1e-12)  # one product each
    for pulse in found.schedule:
        assert pulse.start_us >= found.epoch_us
        assert pulse.start_us + pulse.duration_s * S <= found.valid_until_us
        assert np.count_nonzero(pulse.torque_n_m) == 1


def test_the_prediction_is_what_the_pulses_do_to_a_free_body(craft):
    found = command(row(), craft).command
    inertia = np.array([2600.0, 2600.0, 1400.0])
    step_s = 0.001
    angle, rate = np.zeros(3), np.zeros(3)
    ends = {int(np.flatnonzero(pulse.torque_n_m)[0]): pulse for pulse in found.schedule}
    torque = np.array([ends[axis].torque_n_m[axis] for axis in range(3)])
    duration = np.array([ends[axis].duration_s for axis in range(3)])
    for k in range(int(PERIOD_S / step_s)):
        change = np.where((k + 0.5) * step_s < duration, torque, 0.0) / inertia * step_s
        angle, rate = angle + (rate + change / 2.0) * step_s, rate + change
    # the integration is exact for piecewise constant torques on its grid
    np.testing.assert_allclose(np.deg2rad(found.predicted_angle_change_deg), angle, rtol=1e-6)
    np.testing.assert_allclose(np.deg2rad(found.predicted_rate_change_deg_s), rate, rtol=1e-9)


def test_what_is_too_small_for_a_pulse_is_carried_to_the_next_command(craft):
    tiny = row(attitude=(0.0, 0.001, 0.0), rates=(0.0, 0.0, 0.0))
    outcome = command(tiny, craft)
    assert outcome.command.schedule == ()
    assert outcome.command.control_allowed
    assert outcome.carry_n_m_s[1] < 0.0
    carry = outcome.carry_n_m_s
    while not outcome.command.schedule:
        outcome = command(tiny, craft, carry)
        assert outcome.carry_n_m_s[1] < carry[1] or outcome.command.schedule
        carry = outcome.carry_n_m_s
    assert outcome.command.torque_n_m.roll < 0.0


def test_yaw_alone_may_be_withheld(craft):
    outcome = command(row(allowed=(False, True, True)), craft, carry=np.array([9.0, 0.0, 0.0]))
    assert outcome.command.torque_n_m.yaw == 0.0
    assert outcome.carry_n_m_s[0] == 0.0
    assert outcome.command.torque_n_m.roll < 0.0


REFUSALS = {
    "mode_onboard": lambda craft: replace(craft, control=replace(craft.control, mode=ControlMode.ONBOARD)),
    "mode_off": lambda craft: replace(craft, control=replace(craft.control, mode=ControlMode.OFF)),
    "no_fast_loop": lambda craft: replace(craft, onboard=Onboard(fast_loop=True, forecast_mode=False)),
}


@pytest.mark.parametrize("reason", REFUSALS)
def test_settings_of_the_spacecraft_forbid_a_torque_by_name(craft, reason):
    outcome = command(row(), REFUSALS[reason](craft), carry=np.ones(3))
    assert outcome.command.inhibitions == (reason,)
    assert_zero(outcome)


def test_a_row_without_a_rate_gives_no_torque(craft):
    outcome = command(row(rates=None), craft, carry=np.ones(3))
    assert outcome.command.inhibitions == ("no_rate",)
    assert_zero(outcome)


def test_reasons_of_the_row_come_first_and_make_a_missing_rate_no_news(craft):
    held = row(rates=None, inhibitions=("late", "downlink_fade"))
    found = control_inhibitions(held, REFUSALS["mode_off"](craft))
    assert found == ("late", "downlink_fade", "mode_off")
    assert_zero(command(held, craft))


def test_every_reason_that_stands_here_is_explained():
    assert set(CONTROL_INHIBITIONS) == {*REFUSALS, "no_rate", "no_law", "tripped"}
    assert all(len(text) > 10 for text in CONTROL_INHIBITIONS.values())


def assert_zero(outcome):
    found = outcome.command
    assert not found.control_allowed
    assert found.schedule == ()
    assert not any((*found.torque_n_m, *found.impulse_n_m_s, *found.wheels_n_m))
    assert not any((*found.predicted_angle_change_deg, *found.predicted_wheel_momentum_n_m_s))
    # a wish from before an inhibition is not given after it
    assert not outcome.carry_n_m_s.any()
    assert found.valid_until_us == found.epoch_us + 60 * S


def test_a_real_spacecraft_is_commanded_from_the_receipt_on(craft):
    real = replace(craft, simulated=False)
    assert command(row(), real).command.epoch_us == EPOCH + 3 * S
    early = replace(row(), received_at_us=EPOCH - 5)
    assert command(early, real).command.epoch_us == EPOCH


def test_no_wheel_is_asked_for_more_than_it_has(craft):
    wheels = WheelSet(axes=((1.0, 0, 1), (-1.0, 0, 1), (0, 1.0, 1), (0, -1.0, 1)), torque_limit_n_m=0.04)
    wild = row(attitude=(90.0, 90.0, 90.0), rates=(1.0, 1.0, 1.0))
    found = command(wild, replace(craft, wheels=wheels)).command
    assert found.saturated
    assert len(found.wheels_n_m) == 4
    assert max(abs(torque) for torque in found.wheels_n_m) <= 0.04 * (1.0 + 1e-9)
    assert max(abs(torque) for torque in found.torque_n_m) <= 0.05


def test_the_limit_of_the_catalogue_holds_too(craft):
    wild = row(attitude=(0.0, 90.0, 0.0), rates=(0.0, 1.0, 0.0))
    found = command(wild, replace(craft, torque_limit_n_m=0.01)).command
    assert found.torque_n_m.roll == pytest.approx(-0.01, rel=1e-9)
