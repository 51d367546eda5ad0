"""Checks of a command at its release, and the proposals that come before it."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from service.core.arrays import FloatArray
from service.core.control import slew_schedule
from service.core.control.quaternion_law import inertia_about_angles
from service.pipeline.control.release.command_states import MAY_RELEASE, UNREPORTED, State
from service.pipeline.control.release.events import Refusal, ReleaseState
from service.pipeline.control.release.interlock import Instant, Interlock
from service.pipeline.control.release.interlock_conditions import Condition, Consequence, ReleaseSettings, microseconds
from service.records.catalogue import Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import Axes, Pulse, ScheduleVerdict, TorqueCommand
from service.records.operations.release import Command, CommandCheck, Purpose

_HOUR_US = 3600 * US_PER_S


def release_checks(
    state: ReleaseState,
    command: Command,
    at: Instant,
    settings: ReleaseSettings,
    *,
    envelope: slew_schedule.Envelope | None = None,
    waiting_s: float | None = None,
) -> tuple[CommandCheck, ...]:
    """Return every check of a command against a settled state, those that fail and those that hold.

    The envelope is that of the settings unless another one is authorised; persons may look at the command for
    `waiting_s`, by default as long as a prepared one waits, before its estimate is too old.
    """
    interlock, epoch_us, yaw = state.interlock, command.attitude_epoch_us, command.gross_impulse_n_m_s.yaw
    sent_n_m_s = sent_within_an_hour(state, at.now_us)
    effect = slew_schedule.Effect(*(getattr(command, name) for name in slew_schedule.Effect._fields))
    excesses = slew_schedule.envelope_excesses(effect, sent_n_m_s, envelope or settings.envelope)
    newest_us, period_s = (0, 0.0) if interlock.row is None else (interlock.row.epoch_us, interlock.row.period_s)
    stale_us = settings.stale_us(period_s, settings.prepared_s if waiting_s is None else waiting_s)
    waiting = [each.counter for each in state.commands if each.state in UNREPORTED]
    unreported = f"what became of command {', '.join(map(str, waiting))} is not reported"
    stale = "computed from an estimate that is not the newest any more"
    withheld = "the yaw torque is withheld"
    return (
        _interlock_check(interlock, command),
        _check("envelope", not excesses, "envelope.exceeded", "; ".join(map(str, excesses))),
        _check("yaw", yaw == 0.0 or not _is_yaw_withheld(interlock, command), "interlock.yaw_withheld", withheld),
        _check("reports", not waiting, "command.unreported", unreported),
        _check("estimate", 0 < epoch_us <= newest_us <= epoch_us + stale_us, "command.estimate_stale", stale),
        *_tail_checks(state, command),
        *_schedule_checks(command, at, settings),
    )


def _tail_checks(state: ReleaseState, command: Command) -> tuple[CommandCheck, ...]:
    """Return the check that a sign check cuts no command short: the filter does not get its torque."""
    if not command.is_sign_check:
        return ()
    flying = [
        each.counter
        for each in state.commands
        if not each.is_sign_check and max((pulse.stop_us for pulse in each.executed), default=0) > command.start_us
    ]
    detail = f"command {', '.join(map(str, flying))} is still flown when it would begin"
    return (_check("earlier commands", not flying, "sign_check.flying", detail),)


def _schedule_checks(command: Command, at: Instant, settings: ReleaseSettings) -> tuple[CommandCheck, ...]:
    soonest_us = at.now_us + microseconds(settings.uplink_lead_s)
    latest_us = at.now_us + microseconds(settings.latest_stop_s)
    stop_us = max(command.start_us, command.stop_us, *(pulse.stop_us for pulse in command.schedule))
    lead, limit, verdict = settings.uplink_lead_s, settings.latest_stop_s, command.schedule_verdict
    rejected = f"the flexible-response check says {verdict}"
    passed = f"the uplink needs {lead:g} s: the schedule begins before it can be there"
    too_long = f"the schedule must be over within {limit:g} s: what has gone out no trip can stop"
    return (
        _check("flexible response", verdict == "accept", "schedule.rejected", rejected),
        _check("start", command.start_us >= soonest_us, "command.start_passed", passed),
        _check("end", stop_us <= latest_us, "command.too_long", too_long),
        _check("pulses", bool(command.schedule), "command.empty", "a command without a pulse does nothing"),
    )


def first_failure(checks: tuple[CommandCheck, ...]) -> Refusal | None:
    """Return the refusal of the first check that fails."""
    return next((Refusal(check.code, check.detail) for check in checks if not check.is_ok), None)


def sent_within_an_hour(state: ReleaseState, now_us: int) -> slew_schedule.Triple:
    """Return the sum of the impulses sent within the hour before an instant, yaw, roll, pitch, N m s."""
    recent = [sent.impulse_n_m_s for sent in state.sent if now_us - sent.at_us < _HOUR_US]
    yaw, roll, pitch = (float(sum(values)) for values in zip(*recent, strict=True)) if recent else (0.0, 0.0, 0.0)
    return yaw, roll, pitch


def envelope_left(state: ReleaseState, now_us: int, settings: ReleaseSettings) -> slew_schedule.Envelope:
    """Return the limits of the next command: those in force, and of the hour's impulse what has not been sent."""
    authorisation = state.interlock.authorisation
    limits = settings.envelope if authorisation is None else authorisation.terms.envelope
    left_n_m_s = limits.impulse_an_hour_n_m_s - max(sent_within_an_hour(state, now_us))
    return limits._replace(impulse_n_m_s=max(0.0, min(limits.impulse_n_m_s, left_n_m_s)))


def _is_yaw_withheld(interlock: Interlock, command: Command) -> bool:
    """Return whether a yaw torque is withheld; an unproven sign does not withhold the check that proves it."""
    standing = {each for each in interlock.standing if each.consequence is Consequence.YAW}
    return bool(standing - {Condition.YAW_SIGN} if command.is_sign_check else standing)


def _check(name: str, is_ok: bool, code: str, detail: str) -> CommandCheck:  # noqa: FBT001 - one row of a table
    """Return a check; code and detail stand only where it fails."""
    return CommandCheck(name, is_ok) if is_ok else CommandCheck(name, is_ok, detail, code)


def _interlock_check(interlock: Interlock, command: Command) -> CommandCheck:
    """Return the check that the interlock lets commands go at all."""
    reasons, is_ok, code = ", ".join(interlock.reasons), False, "interlock.inhibited"
    detail = f"control is inhibited: {reasons}"
    if interlock.state is State.TRIPPED:
        code, detail = "interlock.tripped", f"control tripped ({reasons})"
    elif interlock.state is State.BALANCE and command.purpose is Purpose.BALANCE:
        is_ok = interlock.may_balance
    elif interlock.state is State.INHIBITED and not interlock.inhibiting and not interlock.is_armed:
        code, detail = "interlock.not_armed", "control is not armed"
    else:
        is_ok = interlock.state in MAY_RELEASE and not interlock.inhibiting
    return _check("interlock", is_ok, code, detail)


#: predicted angles of a command
_ANGLES = 61
#: parts of an effect with one value an axis
_BY_AXIS = tuple(name for name in slew_schedule.Effect._fields if name != "wheel_momentum_n_m_s")
#: body axes x roll, y pitch, z yaw in the order yaw, roll, pitch
_ANGLES_FROM_BODY = [2, 0, 1]


def proposed(
    spacecraft: Spacecraft,
    attitude_epoch_us: int,
    start_us: int,
    pulses: tuple[slew_schedule.AxisPulse, ...],
    effect: slew_schedule.Effect,
    checked: ScheduleVerdict | None,
    *,
    reason: str,
    purpose: Purpose = Purpose.CONTROL,
    computed: TorqueCommand | None = None,
) -> Command:
    """Return a command that waits for its preparation; `checked` is None where no flexible mode is known."""
    schedule = schedule_of(pulses, start_us)
    by_axis: dict[str, Any] = {name: Axes(*getattr(effect, name)) for name in _BY_AXIS}
    return Command(
        purpose=purpose,
        is_simulated=spacecraft.simulated,
        reason=reason,
        attitude_epoch_us=attitude_epoch_us,
        start_us=start_us,
        stop_us=max((pulse.stop_us for pulse in schedule), default=start_us),
        schedule=schedule,
        schedule_verdict="accept" if checked is None else checked.verdict,
        computed=computed,
        wheel_momentum_n_m_s=effect.wheel_momentum_n_m_s,
        **by_axis,
    )


def proposal_of(command: TorqueCommand, spacecraft: Spacecraft, reason: str) -> Command:
    """Return a command of the law as a proposal; ValueError where pulses overlap or the inertia is that of no body."""
    pulses, checked = pulses_of(command.schedule, command.epoch_us), command.schedule_check
    effect = effect_of_pulses(pulses, spacecraft, command.command_period_s)
    epochs_us = command.attitude_epoch_us, command.epoch_us
    purpose = Purpose.BALANCE if any(command.balance_allowed_axes) else Purpose.CONTROL
    return proposed(spacecraft, *epochs_us, pulses, effect, checked, reason=reason, purpose=purpose, computed=command)


def effect_of_law(command: TorqueCommand, spacecraft: Spacecraft) -> slew_schedule.Effect:
    """Return the effect of a command of the law on angles, rates and wheels; ValueError as `proposal_of`."""
    return effect_of_pulses(pulses_of(command.schedule, command.epoch_us), spacecraft, command.command_period_s)


def effect_of_pulses(
    pulses: tuple[slew_schedule.AxisPulse, ...], spacecraft: Spacecraft, least_horizon_s: float
) -> slew_schedule.Effect:
    """Return the effect of pulses until the horizon, or until the last of them ends."""
    inertia, wheels = _mechanics(spacecraft)
    return slew_schedule.predicted_effect(pulses, inertia, wheels, _horizon_s(pulses, least_horizon_s))


def _horizon_s(pulses: tuple[slew_schedule.AxisPulse, ...], least_s: float) -> float:
    return max([least_s, *(pulse.stop_s for pulse in pulses)])


def angles_of(command: Command, spacecraft: Spacecraft) -> list[tuple[int, Axes]] | None:
    """Return the change of the angles, deg, that a command brings about by its inertia, at instants until its horizon.

    None where it does not end at the change that was stored with the command: the catalogue has another inertia now.
    """
    pulses, (inertia, _) = pulses_of(command.schedule, command.start_us), _mechanics(spacecraft)
    horizon_s = _horizon_s(pulses, 0.0 if command.computed is None else command.computed.command_period_s)
    at_s, angles_deg = slew_schedule.predicted_angles(pulses, inertia, horizon_s, _ANGLES)
    if not np.allclose(angles_deg[-1], command.angle_change_deg, rtol=1e-6, atol=1e-9):
        return None
    instants_us = (command.start_us + np.round(at_s * US_PER_S).astype(np.int64)).tolist()
    return list(zip(instants_us, map(Axes._make, angles_deg.tolist()), strict=True))


def pulses_of(schedule: Sequence[Pulse], start_us: int) -> tuple[slew_schedule.AxisPulse, ...]:
    """Return the elements of a schedule about each axis, in order of time."""
    pulses = [
        slew_schedule.AxisPulse(axis, (element.start_us - start_us) / US_PER_S, element.duration_s, torque_n_m)
        for element in schedule
        for axis, torque_n_m in enumerate(element.torque_n_m)
        if torque_n_m
    ]
    return tuple(sorted(pulses, key=lambda pulse: (pulse.start_s, pulse.axis)))


def schedule_of(pulses: Sequence[slew_schedule.AxisPulse], start_us: int) -> tuple[Pulse, ...]:
    """Return pulses by the calendar, one element a pulse.

    Examples
    --------
    >>> schedule_of((slew_schedule.AxisPulse(1, 2.0, 5.0, 0.01),), 7_000_000)
    (Pulse(start_us=9000000, duration_s=5.0, torque_n_m=Axes(yaw=0.0, roll=0.01, pitch=0.0)),)
    """
    return tuple(
        Pulse(
            start_us + round(pulse.start_s * US_PER_S),
            pulse.duration_s,
            Axes(*(pulse.torque_n_m if axis == pulse.axis else 0.0 for axis in range(3))),
        )
        for pulse in pulses
    )


@lru_cache(maxsize=64)
def _mechanics(spacecraft: Spacecraft) -> tuple[FloatArray, FloatArray]:
    """Return inertia (3, 3) and wheel axes (W, 3) in the order yaw, roll, pitch; nobody may write them."""
    inertia = inertia_about_angles(np.array(spacecraft.inertia_kg_m2))
    axes = np.array(spacecraft.wheels.axes, dtype=np.float64)[:, _ANGLES_FROM_BODY]
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    for array in (inertia, axes):
        array.setflags(write=False)
    return inertia, axes
