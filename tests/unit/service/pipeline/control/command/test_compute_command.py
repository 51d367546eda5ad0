"""Torque commands: zero with reasons, pulses inside their period, what they do, and the verdict of flexible modes."""

from dataclasses import replace

import numpy as np
import pytest

from service.core.control.slew_schedule import Envelope, envelope_excesses
from service.core.flexible.schedule import ScheduleLimits, TorquePulse, check_schedule
from service.core.flexible.spacecraft import HubMode
from service.pipeline.config import TorqueConfig
from service.pipeline.control.command.compute_command import (
    NO_CARRY,
    basis_at,
    basis_of,
    command_for,
    compute_command,
    predicted_deg,
    with_executed,
)
from service.pipeline.control.command.control_design import (
    CONTROL_INHIBITIONS,
    PanelSwing,
    control_inhibitions,
    schedule_verdict,
    swing_after,
)
from service.pipeline.control.release.release_checks import effect_of_law
from service.pipeline.estimation.row_inhibitions import BALANCED, INHIBITIONS
from service.records.catalogue import ControlMode, FlexibleMode, Method, Onboard, Release, WheelSet
from service.records.levels.attitude import Axes, Disturbance, Pulse, row_without_attitude

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


def command(of, record, carry=NO_CARRY, period_s=PERIOD_S):
    return compute_command(of, record, carry, period_s, TorqueConfig())


@pytest.fixture
def record(payload):
    """A simulated spacecraft under ground control."""
    return payload.spacecraft()


def test_a_command_opposes_angles_and_says_when_it_ends(record):
    outcome = command(row(), record)
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


def test_the_mean_torque_is_the_impulse_over_the_period_and_the_pulses_lie_inside_it(record):
    found = command(row(), record).command
    np.testing.assert_allclose(np.array(found.torque_n_m) * PERIOD_S, found.impulse_n_m_s, rtol=1e-12)
    total = sum(np.array(pulse.torque_n_m) * pulse.duration_s for pulse in found.schedule)
    np.testing.assert_allclose(total, found.impulse_n_m_s, rtol=1e-12)  # one product each
    for pulse in found.schedule:
        assert pulse.start_us >= found.epoch_us
        assert pulse.start_us + pulse.duration_s * S <= found.valid_until_us
        assert np.count_nonzero(pulse.torque_n_m) == 1


def test_the_prediction_is_what_the_pulses_do_to_a_free_body(record):
    found = command(row(), record).command
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


def test_what_is_too_small_for_a_pulse_is_carried_to_the_next_command(record):
    tiny = row(attitude=(0.0, 0.001, 0.0), rates=(0.0, 0.0, 0.0))
    outcome = command(tiny, record)
    assert outcome.command.schedule == ()
    assert outcome.command.control_allowed
    assert outcome.carry_n_m_s[1] < 0.0
    carry = outcome.carry_n_m_s
    while not outcome.command.schedule:
        outcome = command(tiny, record, carry)
        assert outcome.carry_n_m_s[1] < carry[1] or outcome.command.schedule
        carry = outcome.carry_n_m_s
    assert outcome.command.torque_n_m.roll < 0.0


def test_yaw_alone_may_be_withheld(record):
    outcome = command(row(allowed=(False, True, True)), record, carry=np.array([9.0, 0.0, 0.0]))
    assert outcome.command.torque_n_m.yaw == 0.0
    assert outcome.carry_n_m_s[0] == 0.0
    assert outcome.command.torque_n_m.roll < 0.0


REFUSALS = {
    "mode_onboard": lambda record: replace(record, control=replace(record.control, mode=ControlMode.ONBOARD)),
    "mode_off": lambda record: replace(record, control=replace(record.control, mode=ControlMode.OFF)),
    "no_fast_loop": lambda record: replace(record, onboard=Onboard(fast_loop=True, forecast_mode=False)),
}


@pytest.mark.parametrize("reason", REFUSALS)
def test_settings_of_the_spacecraft_forbid_a_torque_by_name(record, reason):
    outcome = command(row(), REFUSALS[reason](record), carry=np.ones(3))
    assert outcome.command.inhibitions == (reason,)
    assert_zero(outcome)


def test_a_row_without_a_rate_gives_no_torque(record):
    outcome = command(row(rates=None), record, carry=np.ones(3))
    assert outcome.command.inhibitions == ("no_rate",)
    assert_zero(outcome)


def test_reasons_of_the_row_come_first_and_make_a_missing_rate_no_news(record):
    held = row(rates=None, inhibitions=("late", "downlink_fade"))
    found = control_inhibitions(held, REFUSALS["mode_off"](record))
    assert found == ("late", "downlink_fade", "mode_off")
    assert_zero(command(held, record))


def test_every_reason_that_stands_here_is_explained():
    assert set(CONTROL_INHIBITIONS) == {*REFUSALS, "no_rate", "no_law", "no_body_rate", "law_beyond", "tripped"}
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


def test_a_real_spacecraft_is_commanded_from_the_receipt_on(record):
    real = replace(record, simulated=False)
    assert command(row(), real).command.epoch_us == EPOCH + 3 * S
    early = replace(row(), received_at_us=EPOCH - 5)
    assert command(early, real).command.epoch_us == EPOCH


def test_no_wheel_is_asked_for_more_than_it_has(record):
    wheels = WheelSet(axes=((1.0, 0, 1), (-1.0, 0, 1), (0, 1.0, 1), (0, -1.0, 1)), torque_limit_n_m=0.04)
    wild = row(attitude=(90.0, 90.0, 90.0), rates=(1.0, 1.0, 1.0))
    found = command(wild, replace(record, wheels=wheels)).command
    assert found.saturated
    assert len(found.wheels_n_m) == 4
    assert max(abs(torque) for torque in found.wheels_n_m) <= 0.04 * (1.0 + 1e-9)
    assert max(abs(torque) for torque in found.torque_n_m) <= 0.05


def test_a_command_that_counts_as_applied_keeps_to_what_an_hour_may_have(record):
    wild = row(attitude=(0.0, 9.0, 0.4), rates=(0.0, 1.0, 0.0))
    found = command(wild, replace(record, torque_limit_n_m=0.004)).command
    # pulses are whole steps of the drive
    assert found.torque_n_m.roll * 3600.0 == pytest.approx(-0.095, rel=0.01)
    assert found.saturated
    # an axis that asks for little loses nothing by it
    alone = command(row(attitude=(0.0, 0.0, 0.4), rates=(0.0, 0.0, 0.0)), record).command
    assert found.torque_n_m.pitch == pytest.approx(alone.torque_n_m.pitch, rel=0.02)
    assert max(abs(pulse.torque_n_m.roll) for pulse in found.schedule) <= 0.004
    assert not envelope_excesses(effect_of_law(found, record), (0.0, 59 * 0.095 / 60, 0.0), Envelope())


def pushed(roll_n_m):
    return Disturbance(0, 86_400.0, Axes(0.0, roll_n_m, 0.0), ZERO, ZERO, ZERO)


STILL = {"attitude": (0.0, 0.0, 0.0), "rates": (0.0, 0.0, 0.0)}


def test_a_known_torque_is_fed_forward(record):
    carry = np.zeros(3)
    given = np.zeros(3)
    for _ in range(60):
        outcome = compute_command(row(**STILL), record, carry, PERIOD_S, TorqueConfig(), pushed(4e-7))
        carry, given = outcome.carry_n_m_s, given + np.array(outcome.command.impulse_n_m_s)
    # an hour of it, but for what stays below the shortest pulse
    np.testing.assert_allclose(given, [0.0, -4e-7 * 3600.0, 0.0], atol=2.1e-4)


def test_while_the_interlock_withholds_nothing_is_commanded(record):
    outcome = compute_command(row(), record, np.ones(3), PERIOD_S, TorqueConfig(), is_withheld=True)
    assert outcome.command.inhibitions == ("tripped",)
    assert_zero(outcome)


def test_a_spacecraft_without_a_law_gives_no_torque_and_says_so(record):
    quick = replace(record, control=replace(record.control, period_s=10.0))
    for release in Release:
        outcome = command(row(), replace(quick, control=replace(quick.control, release=release)))
        assert outcome.command.inhibitions == ("no_law",)
        assert_zero(outcome)


def test_a_wheel_at_its_limit_of_momentum_takes_no_more(record):
    def momentum_of(roll_n_m_s):
        reported = compute_command(
            row(attitude=(0.0, 0.4, 0.0)), record, NO_CARRY, PERIOD_S, TorqueConfig(), None, (roll_n_m_s, 0.0, 0.0)
        ).command
        assert reported.saturated is (roll_n_m_s == 20.0)
        return reported.predicted_wheel_momentum_n_m_s

    # roll is pushed back, so its wheel gains momentum
    assert momentum_of(0.0)[0] > 1e-4
    assert momentum_of(-20.0)[0] > 1e-4
    assert momentum_of(20.0)[0] == 0.0


def test_a_fourth_wheel_is_kept_away_from_zero_speed(record):
    wheels = WheelSet(axes=((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0), (0.577, 0.577, 0.577)))
    momentum = (1.0, 1.0, 1.0, 0.05)
    reported = compute_command(
        row(**STILL), replace(record, wheels=wheels), NO_CARRY, PERIOD_S, TorqueConfig(), None, momentum
    ).command
    ending = np.array(momentum) + reported.predicted_wheel_momentum_n_m_s
    assert np.abs(ending).min() >= 0.2 * (1.0 - 1e-9)
    np.testing.assert_allclose(np.array(reported.wheels_n_m) @ np.array(wheels.axes), 0.0, atol=1e-6)


def test_released_in_two_steps_a_command_lies_in_its_period_and_is_its_mean(record):
    two_step = replace(record, control=replace(record.control, release=Release.TWO_STEP))
    outcome = compute_command(row(), two_step, np.ones(3), 900.0, TorqueConfig(), pushed(4e-7))
    found = outcome.command
    assert not outcome.carry_n_m_s.any()
    np.testing.assert_allclose(np.array(found.torque_n_m) * 900.0, found.impulse_n_m_s, rtol=1e-12)
    for pulse in found.schedule:
        assert pulse.start_us >= found.epoch_us
        assert pulse.start_us + pulse.duration_s * S <= found.valid_until_us == found.epoch_us + 900 * S
    # each axis has its pulse back
    for axis in range(3):
        signs = {np.sign(pulse.torque_n_m[axis]) for pulse in found.schedule if pulse.torque_n_m[axis]}
        assert signs == {-1.0, 1.0}


def test_a_command_with_a_later_start_knows_where_the_craft_will_be(record):
    two_step = replace(record, control=replace(record.control, release=Release.TWO_STEP))
    moving = row(attitude=(0.0, -0.1, 0.0), rates=(0.0, 1e-4, 0.0))
    # 0.1 deg at 1e-4 deg/s: there in 1000 s, and the rate alone is to be taken
    found = command_for(moving, two_step, EPOCH + 1000 * S, 900.0, None, TorqueConfig())
    assert found.epoch_us == EPOCH + 1000 * S
    assert found.predicted_rate_change_deg_s.roll == pytest.approx(-1e-4, rel=0.02)
    assert found.attitude_epoch_us == EPOCH
    weak = command_for(moving, two_step, EPOCH, 900.0, 0.002, TorqueConfig())
    assert {abs(pulse.torque_n_m.roll) for pulse in weak.schedule} <= {0.0, 0.002}
    held = command_for(row(inhibitions=("late",)), two_step, EPOCH, 900.0, None, TorqueConfig())
    assert (held.inhibitions, held.schedule, held.schedule_check) == (("late",), (), None)


def test_an_hour_without_impulse_left_gets_a_command_without_pulses(record):
    two_step = replace(record, control=replace(record.control, release=Release.TWO_STEP))
    spent = Envelope()._replace(impulse_n_m_s=0.0)
    for duration_s in (900.0, 3600.0):
        found = command_for(row(), two_step, EPOCH, duration_s, None, TorqueConfig(), pushed(1e-6), envelope=spent)
        assert found.schedule == ()


@pytest.mark.parametrize("seed", range(6))
def test_whatever_the_law_asks_for_the_release_finds_inside_the_envelope(record, seed):
    rng = np.random.default_rng(seed)
    for _ in range(60):
        period_s, duration_s = rng.choice([300.0, 600.0, 900.0]), rng.choice([300.0, 600.0, 900.0, 3600.0])
        control = replace(record.control, release=Release.TWO_STEP, command_period_s=period_s)
        two_step = replace(record, control=control)
        moving = row(rng.uniform(-1.0, 1.0, 3), rng.normal(scale=6e-5, size=3))
        envelope = Envelope(*(rng.uniform(0.2, 1.0) * limit for limit in Envelope()))
        envelope = envelope._replace(impulse_n_m_s=min(envelope.impulse_n_m_s, envelope.impulse_an_hour_n_m_s))
        command = command_for(
            moving, two_step, EPOCH, duration_s, None, TorqueConfig(), pushed(rng.uniform(0, 3e-6)), envelope=envelope
        )
        excesses = envelope_excesses(effect_of_law(command, two_step), (0.0, 0.0, 0.0), envelope)
        assert not excesses, f"seed {seed}: {', '.join(map(str, excesses))}"


def test_a_schedule_is_held_against_the_flexible_modes(record):
    modes = (FlexibleMode("roll", 0.6, 0.003, 0.4), FlexibleMode("pitch", 0.3, 0.003, 0.4))
    flexible = replace(record, modes=modes)
    assert command(row(), record).command.schedule_check is None
    check = command(row(), flexible).command.schedule_check
    assert (check.verdict, check.suggestion) == ("accept", None)
    assert 0.0 < check.residual_deg < 1.05 * check.peak_deg
    assert check.margin == pytest.approx(1.0 - check.peak_deg / TorqueConfig().panel_peak_limit_deg)
    # half of what it does is allowed
    strict = replace(TorqueConfig(), panel_peak_limit_deg=check.peak_deg / 2.0)
    refused = compute_command(row(), flexible, NO_CARRY, PERIOD_S, strict).command.schedule_check
    assert refused.verdict == "reject"
    assert refused.margin < 0.0
    assert command(row(**STILL), flexible).command.schedule_check is None


MODES = (FlexibleMode("pitch", 0.3, 0.003, 0.4), FlexibleMode("roll", 0.6, 0.003, 0.4))


def roll(at_s, torque_n_m=0.02, duration_s=1.0):
    return Pulse(EPOCH + round(at_s * S), duration_s, Axes(0.0, torque_n_m, 0.0))


@pytest.fixture
def swinging(payload):
    return replace(payload.spacecraft(), modes=MODES)


def test_the_verdict_is_that_of_the_analysis_of_the_axis(swinging):
    reported = schedule_verdict((roll(10.0), roll(40.0)), swinging, TorqueConfig())
    (inertia,) = {swinging.inertia_kg_m2[0][0]}
    limits = ScheduleLimits(
        inertia, (HubMode(0.6, 0.003, 0.4),), float(np.radians(TorqueConfig().panel_peak_limit_deg))
    )
    own = check_schedule((TorquePulse(0.0, 1.0, 0.02), TorquePulse(30.0, 1.0, 0.02)), limits, (0j,))
    assert (reported.verdict, reported.worst_mode) == (own.verdict, 1)
    assert reported.peak_deg == pytest.approx(np.degrees(own.metrics.peak_rad), rel=1e-12)
    assert reported.residual_deg == pytest.approx(np.degrees(own.metrics.residual_rad), rel=1e-12)


def test_without_modes_or_pulses_there_is_none(swinging):
    assert schedule_verdict((roll(0.0),), replace(swinging, modes=()), TorqueConfig()) is None
    assert schedule_verdict((), swinging, TorqueConfig()) is None
    assert swing_after(None, (roll(0.0),), replace(swinging, modes=())) is None


def test_what_one_schedule_leaves_counts_for_the_next_and_fades(swinging):
    alone = schedule_verdict((roll(100.0),), swinging, TorqueConfig())
    swing = swing_after(None, (roll(0.0),), swinging)
    soon = schedule_verdict((roll(100.0),), swinging, TorqueConfig(), swing)
    late = schedule_verdict((roll(7200.0),), swinging, TorqueConfig(), swing)
    assert soon.peak_deg > 1.5 * alone.peak_deg
    assert late.peak_deg == pytest.approx(alone.peak_deg, rel=1e-4)


def test_two_halves_of_a_schedule_leave_what_the_whole_leaves(swinging):
    first, second = (roll(0.0), roll(20.0, -0.02)), (roll(50.0), roll(61.0, 0.01, 3.0))
    whole = swing_after(None, (*first, *second), swinging)
    parts = swing_after(swing_after(None, first, swinging), second, swinging)
    assert whole.at_us == parts.at_us
    np.testing.assert_allclose(parts.phasor_rad, whole.phasor_rad, rtol=1e-9)
    assert swing_after(parts, (), swinging) is parts


def test_a_rejected_schedule_comes_with_what_helps(swinging):
    strict = replace(TorqueConfig(), panel_peak_limit_deg=1.5e-4)
    period_s = 2.0 * np.pi / 0.6
    resonant = tuple(roll(k * period_s) for k in range(8))
    reported = schedule_verdict(resonant, swinging, strict)
    assert reported.verdict == "reject"
    assert reported.suggestion is not None


def test_swings_of_other_modes_are_forgotten_and_a_mode_without_damping_is_given_a_little(swinging):
    swing = PanelSwing(EPOCH, (1.0 + 0j,))
    reported = schedule_verdict((roll(0.0),), swinging, TorqueConfig(), swing)
    assert reported == schedule_verdict((roll(0.0),), swinging, TorqueConfig())
    undamped = replace(swinging, modes=(replace(MODES[1], damping_ratio=0.0),))
    assert schedule_verdict((roll(0.0),), undamped, TorqueConfig()) is not None


PUSHED = Disturbance(EPOCH, 86_400.0, Axes(0.0, 2e-6, -1e-6), ZERO, ZERO, Axes(1e-7, 1e-7, 1e-7))
INERTIA = np.array([2600.0, 2600.0, 1400.0])
NIGHT = ("downlink_fade",)


def known(age_s=600.0, rates=(0.0, 0.0, 0.0), axes=(True, True, True), disturbance=PUSHED, of=None):
    """Return what a row that control could use, some time ago, lets be balanced."""
    then = row(rates=rates, allowed=axes, sigma_deg=Axes(0.1, 0.02, 0.03)) if of is None else of
    return basis_of(replace(then, epoch_us=EPOCH - round(age_s * S)), disturbance)


def doubted(basis, record, inhibitions=NIGHT, rates=(0.0, 0.0, 0.0), release=Release.TWO_STEP, **changes):
    """Return what is commanded for a row that control may not use."""
    record = replace(record, control=replace(record.control, release=release))
    inhibited = row(rates=rates, inhibitions=inhibitions, sigma_deg=Axes(0.1, 0.02, 0.03))
    inhibited = replace(inhibited, control_allowed=False, control_allowed_axes=(False,) * 3)
    return compute_command(inhibited, record, NO_CARRY, 3600.0, TorqueConfig(), PUSHED, basis=basis, **changes).command


def test_while_angles_are_doubted_the_known_torque_is_balanced_and_no_angle_is_corrected(record):
    found = doubted(known(), record)
    assert (found.control_allowed, found.balance_allowed_axes) == (False, (True, True, True))
    assert (found.is_permitted, found.inhibitions) == (True, NIGHT)
    # the angles, 0.3, 0.4, -0.3 deg, would ask for torques about all axes
    np.testing.assert_allclose(found.torque_n_m, -np.array(PUSHED.constant_n_m), atol=2e-7)


def test_a_rate_is_taken_away_too_and_one_that_is_not_known_counts_as_none(record):
    rest, turning = doubted(known(), record), doubted(known(), record, rates=(0.0, 0.0, 2e-5))
    assert turning.impulse_n_m_s.pitch < rest.impulse_n_m_s.pitch
    assert doubted(known(), record, rates=None).impulse_n_m_s == rest.impulse_n_m_s


def test_the_prediction_has_rates_torque_and_what_was_executed(record):
    basis = known(3600.0, rates=(0.0, 1e-6, 0.0))
    pulse = Pulse(EPOCH - 1800 * S, 10.0, Axes(0.0, 0.0, 4e-4))
    later = Pulse(EPOCH + 60 * S, 10.0, Axes(0.0, 0.0, 9.0))
    # of an older command, which the pulse replaces
    older = Pulse(EPOCH - 1500 * S, 10.0, Axes(9.0, 0.0, 0.0))
    pushed = 6.48e6 * np.degrees(np.array(PUSHED.constant_n_m) / INERTIA)
    expected = [0.3, 0.4 + 3.6e-3 + pushed[1], -0.3 + pushed[2] + 1795.0 * np.degrees(4e-3 / 1400.0)]
    found = predicted_deg(with_executed(with_executed(basis, (older,)), (pulse, later)), EPOCH, record)
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("reason", [*sorted(set(INHIBITIONS) - BALANCED), "tripped", "mode_onboard", "no_fast_loop"])
def test_nothing_is_balanced_where_more_than_the_angle_is_doubted(record, reason):
    found = doubted(known(), record, (*NIGHT, reason))
    assert (found.is_permitted, found.schedule) == (False, ())


def test_of_commands_that_count_as_applied_nothing_is_balanced(record):
    assert not doubted(known(), record, release=Release.AUTOMATIC).is_permitted


def test_of_a_row_without_rates_nothing_is_balanced():
    assert basis_of(row(rates=None, sigma_deg=Axes(0.1, 0.02, 0.03)), PUSHED) is None


def test_a_trip_ends_balance(record):
    assert not doubted(known(), record, is_withheld=True).is_permitted


def test_balance_ends_after_three_hours_and_where_the_seen_angle_leaves_the_predicted_one_by_four_sigma(record):
    seen = row(sigma_deg=Axes(0.1, 0.02, 0.03))
    still = known(disturbance=None)
    assert basis_at(still, seen, record, 600.0) is still
    assert basis_at(still, seen, record, 599.0) is None
    for axis, sigma_deg in enumerate(seen.sigma_deg):
        for sigmas, is_held in ((3.9, True), (4.1, False)):
            moved = np.array(seen.attitude_deg) + sigmas * np.sqrt(2.0) * sigma_deg * np.eye(3)[axis]
            found = basis_at(still, replace(seen, attitude_deg=Axes(*moved)), record, 600.0)
            assert (found is still) is is_held
    # an angle that nobody sees contradicts nothing
    assert basis_at(still, replace(seen, attitude_deg=Axes(*[np.nan] * 3)), record, 600.0) is still
    # of a torque that is hardly known the prediction is hardly known
    vague = known(7200.0, disturbance=replace(PUSHED, sigma_n_m=Axes(2e-6, 2e-6, 2e-6)))
    assert basis_at(vague, seen, record, 7200.0) is vague


def test_an_axis_that_control_could_not_use_is_not_balanced(record):
    found = doubted(known(axes=(False, True, True)), record, rates=(1e-4, 0.0, 0.0))
    assert {tuple(np.flatnonzero(pulse.torque_n_m)) for pulse in found.schedule} <= {(1,), (2,)}
    assert found.torque_n_m.roll < 0.0
