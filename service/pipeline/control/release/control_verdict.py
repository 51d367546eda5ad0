"""Verdict on control with a sentence and a next step each, and its conditions as a list: met, not met, not judged."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

from service.core.control.slew_schedule import Envelope
from service.core.estimation.filtering.integrity import DOUBT_RATIO, WAITING_LOSS_DEG
from service.pipeline.config import InterlockConfig
from service.pipeline.control.command.control_design import CONTROL_INHIBITIONS
from service.pipeline.control.release.command_states import OPEN, UNREPORTED, State
from service.pipeline.control.release.events import ReleaseState
from service.pipeline.control.release.interlock import unreported_since_us
from service.pipeline.control.release.interlock_conditions import (
    MEASURES,
    OF_ROW,
    Condition,
    Consequence,
    Measure,
    ReleaseSettings,
    condition_limits,
    greater_angle_deg,
    input_values,
    microseconds,
    row_values,
)
from service.pipeline.control.release.release_checks import sent_within_an_hour
from service.pipeline.estimation.row_inhibitions import INHIBITIONS
from service.records.catalogue import ControlMode, Method, Release, Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import AttitudeRow, Axes, TorqueCommand, row_without_attitude
from service.records.operations.release import SignCheck

#: states in which torques go, by hand or by themselves
_GIVING = frozenset({State.ARMED.name, State.ENGAGED.name, State.RECOVERY.name})
#: reasons that withhold yaw alone
_YAW_ONLY = frozenset(each.word for each in Condition if each.consequence is Consequence.YAW)
#: reasons that are neither conditions of the interlock nor inhibitions of rows and commands
OTHER_REASONS = {
    "estimator_failed": "the estimator fails, no attitude is computed",
    "not_armed": "control is not armed",
    "good_minutes": "{good_min:g} minutes without a reason are not over",
    "no_attitude": "no attitude has been computed yet",
    "expired": "the newest attitude is too old, or stands on older data",
    "invalid": "the newest row gives no attitude",
    "release_unreadable": "the state of the interlock cannot be read",
}

#: next step, with the codes that it is for, by blanks
_NEXT_STEPS = {
    "Read the service log and run `soo doctor`: rows are kept and computed later.": "estimator_failed",
    "Wait: it clears by itself.": "late catch_up settling no_rate gap good_minutes chain_step",
    "Check links and newest_measurement of GET .../status.": "estimate_old no_attitude expired",
    "Check the excluded carriers of GET .../attitude; if all are missing, the receiving chain.": (
        "no_fix invalid redundancy sigma_roll sigma_pitch protection_level integrity_unmonitored"
    ),
    "Look at live rows: a smoothed row is about the past and never drives control.": "smoothed",
    "Turn in yaw or add carriers that tell yaw; roll and pitch go on.": "yaw_uncertain",
    "Check the inhibitions of GET .../attitude.": "estimator",
    "Wait for the end of the rain; without rain check the receiving chain.": "fade downlink_fade",
    "Look at the receiving chain; POST .../alignments if the change stays.": "common_change",
    "Compare with another sensor; align again if the estimate is wrong.": "innovations innovation",
    "Find out what moves the spacecraft; declare it as an operation or a correction.": "unannounced_motion",
    "Declare the operation with POST .../operations.": "undeclared_operation",
    "Calibrate, then POST .../calibrations/{id}:activate.": "no_calibration",
    "POST .../alignments.": "not_aligned",
    "PUT .../ephemeris with the newest orbit.": "no_ephemeris ephemeris",
    "Wait for the end of the operation, or PATCH .../operations/{id}.": "operation",
    "Bring the angle back by another sensor or confirmed commands.": "beyond_validity hand_over",
    "Read the service log and report the failure.": "internal_error release_unreadable",
    "Set entry_modes or wait for the on-board mode.": "onboard_mode",
    "POST .../torques/{id}:executed or :failed.": "report_late",
    "POST .../torques/{id}:executed or :failed; then POST .../control:reset.": "unreported",
    "POST .../control:sign-check for yaw; roll and pitch go on.": "yaw_sign",
    "POST .../control:arm.": "not_armed",
    "PATCH control.mode to ground if the ground is to compute torques.": "mode_onboard mode_off",
    "State onboard.fast_loop and onboard.forecast_mode in the catalogue.": "no_fast_loop",
    "Correct inertia, wheels, period or damping of the catalogue.": "no_law",
    "Send telemetry with body rates.": "no_body_rate",
    "Bring the rates down with another control mode.": "law_beyond",
    "Find the cause; then POST .../control:reset.": (
        "clock_jump momentum response_missed envelope configuration stop tripped"
    ),
    "Stop the other service on this archive; then POST .../control:reset.": "lease",
    "Restore it from a backup, or make and activate it again; then POST .../control:reset.": "document_corrupt",
}
_NEXT_STEP = {code: step for step, codes in _NEXT_STEPS.items() for code in codes.split()}
#: reasons that follow from others, named behind those: the first reason is the one to act on
_NAMED_LAST = (
    *("not_aligned", "unannounced_motion", "fade", "redundancy", "expired", "estimate_old", "no_attitude", "invalid"),
    *("estimator", "tripped", "operation", "good_minutes", "not_armed"),
)
#: conditions that a verdict names, by code
CONDITIONS = {each.word: each for each in Condition if each.consequence is not Consequence.ALARM}
#: every code that a verdict may name
CODES = frozenset((*CONDITIONS, *INHIBITIONS, *CONTROL_INHIBITIONS, *OTHER_REASONS))


@dataclass(frozen=True, slots=True)
class ControlReason:
    """A reason why no torque may go, or why yaw is withheld."""

    code: str
    text: str
    since_us: Annotated[int | None, "Since when it has stood without a break; null: not known."]
    next_step: str


@dataclass(frozen=True, slots=True)
class ControlVerdict:
    """The one answer to the question whether a torque may go now."""

    is_allowed: Annotated[
        bool, "False whenever the interlock or the newest attitude forbids; read this one for a decision."
    ]
    state: Annotated[str, "ENGAGED under release automatic: computed commands count as applied."]
    reasons: Annotated[
        tuple[ControlReason, ...],
        "All active reasons, the one to act on first; while allowed, those that withhold yaw alone.",
    ]


@dataclass(frozen=True, slots=True)
class GoodMinutes:
    """Progress of the time without a condition that inhibits or trips, which arming and clearing ask for."""

    since_us: Annotated[int | None, "Null: such a condition stands."]
    elapsed_s: Annotated[float, "Not more than what is needed."]
    needed_s: float


class ConditionValue(NamedTuple):
    """Value of a condition and its limit; NaN: not known, or none."""

    measure: Measure
    value: float = math.nan
    limit: float = math.nan


@dataclass(frozen=True, slots=True)
class ControlView:
    """View of the interlock of one spacecraft; a text beside a type is the description in the interface."""

    state: Annotated[str, "That of `control`."]
    since_us: int
    reasons: Annotated[tuple[ControlReason, ...], "Codes of the reasons of `control`."]
    trips: Annotated[tuple[str, ...], "Latched until reset, a part of the reasons."]
    good_minutes: GoodMinutes
    #: of the conditions of the interlock that are judged by a number
    condition_values: Mapping[str, ConditionValue]
    #: without one, conditions that lie in it are not judged
    has_row: bool
    is_armed: bool
    is_withheld: Annotated[bool, "Computed commands are zeroed: from a trip until ten good minutes after its reset."]
    release: Release
    mode: ControlMode
    envelope: Annotated[Envelope, "That of the standing authorisation, else that of the settings."]
    authorised_by: tuple[str, ...]
    authorised_until_us: int | None
    requested_by: Annotated[str | None, "Who waits for a second person to engage."]
    requested_until_us: int | None
    proven_axes: tuple[str, ...]
    #: counters
    open_commands: Annotated[tuple[int, ...], "Wait for a confirmation."]
    unreported_commands: Annotated[tuple[int, ...], "Wait for a report."]
    sent_impulse_n_m_s: Annotated[Axes, "Sum of the sizes of what was sent within the hour."]
    sign_check: SignCheck | None = None


def reason_of(code: str, since_us: int | None = None, settings: ReleaseSettings | None = None) -> ControlReason:
    """Return a reason in words; figures are those of the settings, by default those of the reference.

    A code that another version has stored is its own text.

    Examples
    --------
    >>> reason_of("hand_over").text
    'roll or pitch beyond 2 deg, its sign in doubt: over to the sensor mode (alarm)'
    """
    known = (
        INHIBITIONS | CONTROL_INHIBITIONS | OTHER_REASONS | {word: each.meaning for word, each in CONDITIONS.items()}
    )
    figures = (settings or ReleaseSettings()).figures
    text, next_step = known.get(code, code).format(**figures), _NEXT_STEP.get(code, _NEXT_STEP["estimator"])
    return ControlReason(code, text, since_us, next_step)


def control_view(state: ReleaseState, spacecraft: Spacecraft, settings: ReleaseSettings, now_us: int) -> ControlView:
    """Return what the interlock says."""
    interlock = state.interlock
    authorisation, request, since = interlock.authorisation, interlock.request, dict(interlock.since)
    reasons = [reason_of(word, since.get(word) or None, settings) for word in interlock.reasons]
    if documents := ", ".join(interlock.inputs.damaged_documents):
        word = Condition.DOCUMENT_CORRUPT.word
        reasons = [replace(each, text=f"{each.text}: {documents}") if each.code == word else each for each in reasons]
    if request is not None and now_us - request.at_us > microseconds(settings.request_s):
        request = None
    return ControlView(
        state=interlock.state.name,
        since_us=interlock.since_us,
        reasons=tuple(reasons),
        trips=tuple(condition.word for condition in interlock.trips),
        good_minutes=_good_minutes(interlock.good_since_us, now_us, settings),
        condition_values=_condition_values(state, settings, now_us),
        has_row=interlock.row is not None,
        is_armed=interlock.is_armed,
        is_withheld=interlock.is_withholding,
        release=spacecraft.control.release,
        mode=spacecraft.control.mode,
        envelope=settings.envelope if authorisation is None else authorisation.terms.envelope,
        authorised_by=() if authorisation is None else authorisation.persons,
        authorised_until_us=None if authorisation is None else authorisation.terms.until_us,
        requested_by=None if request is None else request.by,
        requested_until_us=None if request is None else request.terms.until_us,
        proven_axes=interlock.proven_axes,
        open_commands=tuple(each.counter for each in state.commands if each.state in OPEN),
        unreported_commands=tuple(each.counter for each in state.commands if each.state in UNREPORTED),
        sent_impulse_n_m_s=Axes(*sent_within_an_hour(state, now_us)),
        sign_check=state.sign_check,
    )


def control_verdict(
    view: ControlView | None,
    newest: TorqueCommand | AttitudeRow | None,
    failure: str | None = None,
    age_s: float | None = None,
) -> ControlVerdict:
    """Return the verdict on control.

    Parameters
    ----------
    view : ControlView or None
        Interlock; None: it cannot be read, which forbids control.
    newest : TorqueCommand or AttitudeRow or None
        Newest command of the method that drives control as it holds now, else its newest row; None: neither exists.
    failure : str or None
        Error that comes back with every try to compute an attitude.
    age_s : float or None
        Of the newest row, where it is known.

    Returns
    -------
    ControlVerdict
        Allowed when neither interlock nor row forbids. In release ``automatic`` nobody arms: the state is ENGAGED
        while allowed.
    """
    found = {} if view is None else {reason.code: reason for reason in view.reasons}
    if failure is not None:
        reason = reason_of("estimator_failed")
        found[reason.code] = replace(reason, text=f"{reason.text}: {failure}")
    if view is None:
        found["release_unreadable"] = reason_of("release_unreadable")
    # the interlock itself names the condition that tripped
    inhibitions = ("no_attitude",) if newest is None else tuple(one for one in newest.inhibitions if one != "tripped")
    if "expired" in inhibitions:
        # what else the row says is about the past
        inhibitions, reason = ("expired",), reason_of("expired")
        text = reason.text if age_s is None else f"the newest row is {_in_words(age_s)} old"
        found["expired"] = replace(reason, text=text)
    for code in inhibitions:
        found.setdefault(code, reason_of(code))
    if inhibitions:
        # the row's own reasons say the same in full
        found.pop(Condition.ESTIMATOR.word, None)
    is_forbidden = not _YAW_ONLY.issuperset(found)
    state = State.INHIBITED.name if view is None else view.state
    if view is not None and view.release == Release.AUTOMATIC and state != State.TRIPPED.name:
        state = State.INHIBITED.name if is_forbidden else State.ENGAGED.name
    return ControlVerdict(state in _GIVING and not is_forbidden, state, tuple(sorted(found.values(), key=_rank)))


def _rank(reason: ControlReason) -> tuple[bool, int]:
    """Return the place of a reason among others, least first; those that hold back yaw alone come last."""
    named_last = _NAMED_LAST.index(reason.code) if reason.code in _NAMED_LAST else -1
    return reason.code in _YAW_ONLY, -2 if reason.code == "estimator_failed" else named_last


def _in_words(age_s: float) -> str:
    """Return an age in the largest unit of which there are two."""
    units = (("days", 86_400.0), ("h", 3600.0), ("min", 60.0))
    return next((f"{age_s / s:.1f} {unit}" for unit, s in units if age_s >= 2.0 * s), f"{age_s:.0f} s")


def _good_minutes(since_us: int | None, now_us: int, settings: ReleaseSettings) -> GoodMinutes:
    """Return how many of the good minutes have passed."""
    elapsed_s = 0.0 if since_us is None else (now_us - since_us) / US_PER_S
    return GoodMinutes(since_us, min(max(elapsed_s, 0.0), settings.good_s), settings.good_s)


def _condition_values(state: ReleaseState, settings: ReleaseSettings, now_us: int) -> dict[str, ConditionValue]:
    """Return values and limits of the conditions of the interlock."""
    interlock = state.interlock
    unreported = [each for each in state.commands if each.state in UNREPORTED]
    innovation_us, ended_us = interlock.innovation_since_us, [unreported_since_us(each) for each in unreported]
    values = {
        **row_values(interlock.row, now_us),
        **input_values(interlock.inputs, now_us),
        Condition.INNOVATION: 0.0 if innovation_us is None else (now_us - innovation_us) / US_PER_S,
        Condition.UNREPORTED: len(unreported),
    }
    if ended_us:
        values[Condition.REPORT_LATE] = max(now_us - min(ended_us), 0) / US_PER_S
    if interlock.row is None:
        del values[Condition.INNOVATION]
    limits = condition_limits(interlock.row, settings)
    return {
        condition.word: ConditionValue(measure, values.get(condition, math.nan), limits.get(condition, math.nan))
        for condition, measure in MEASURES.items()
    }


_CONSEQUENCES = {
    Consequence.INHIBIT: "inhibit",
    Consequence.TRIP: "trip",
    Consequence.YAW: "yaw",
}
_GOOD_MINUTES = Measure("time without a condition that inhibits or trips", "s", is_least=True)
_PROTECTION = Measure("greater protection level of roll and pitch", "deg")
#: codes of conditions in their order; of a trip the interlock names the condition
_LISTED = tuple(
    code
    for code in dict.fromkeys((*CONDITIONS, *INHIBITIONS, *CONTROL_INHIBITIONS, *OTHER_REASONS))
    if code != "tripped"
)


@dataclass(frozen=True, slots=True)
class ControlCondition:
    """A condition of the verdict, whether it is met or not."""

    code: Annotated[str, "Not met: a reason of this code stands."]
    is_met: Annotated[bool | None, "Null: nothing to judge it by yet, or another reason comes before it."]
    consequence: Annotated[str, "Where it is not met; yaw: the yaw torque alone."]
    value: Annotated[float | None, "Null: not known, or it is no number."]
    limit: Annotated[float | None, "Null: none, or it needs a row."]
    bound: Annotated[str | None, "Which good value the limit is."]
    unit: str
    since_us: Annotated[int | None, "Since when it has not been met without a break; null: it is met, or not known."]


def control_conditions(
    view: ControlView | None, row: AttitudeRow | None, verdict: ControlVerdict, limits: InterlockConfig
) -> tuple[ControlCondition, ...]:
    """Return every condition of a verdict: those that are not met are its reasons, and allowed is it when all are met.

    Parameters
    ----------
    view : ControlView or None
        Interlock of the verdict.
    row : AttitudeRow or None
        Newest row of the verdict.
    limits : InterlockConfig
        Limits of the estimator.

    Returns
    -------
    tuple of ControlCondition
        In the order of the interlock's table, then those of rows, commands and arming; codes of other versions last.
        Those that withhold yaw alone do not count for "all".
    """
    values = _values_of(view, row, limits)
    unjudged = _unjudged(view, verdict)
    since = {reason.code: reason.since_us for reason in verdict.reasons}
    made = []
    for code in dict.fromkeys((*_LISTED, *since)):
        measure, value, limit = values.get(code, (None, math.nan, math.nan))
        condition = CONDITIONS.get(code)
        made.append(
            ControlCondition(
                code=code,
                is_met=False if code in since else None if code in unjudged else True,
                consequence="inhibit" if condition is None else _CONSEQUENCES[condition.consequence],
                value=value if math.isfinite(value) else None,
                limit=limit if math.isfinite(limit) else None,
                bound=None if measure is None else "least" if measure.is_least else "greatest",
                unit="" if measure is None else measure.unit,
                since_us=since.get(code),
            )
        )
    return tuple(made)


def _values_of(view: ControlView | None, row: AttitudeRow | None, limits: InterlockConfig) -> dict[str, ConditionValue]:
    """Return values and limits by code: those of the interlock, of the newest row, and of the good minutes."""
    found = {} if view is None else dict(view.condition_values)
    if view is not None:
        good = view.good_minutes
        found["good_minutes"] = ConditionValue(_GOOD_MINUTES, good.elapsed_s, good.needed_s)
    if row is not None:
        fade_db = row.downlink_fade_db if row.downlink_fade_db > 0.0 or not row.downlink_fade else math.nan
        found["fade"] = found["downlink_fade"] = ConditionValue(MEASURES[Condition.FADE], fade_db)
    # limits hold before the first row too
    row = row or row_without_attitude(0, 0, 0, Method.ROBUST, ())
    level_deg, nominal_deg = greater_angle_deg(row.protection_deg), greater_angle_deg(row.nominal_protection_deg)
    is_urgent = greater_angle_deg(row.waiting_loss_deg) > WAITING_LOSS_DEG
    alert_deg = limits.alert_limit_deg
    found["beyond_validity"] = ConditionValue(
        MEASURES[Condition.HAND_OVER], greater_angle_deg(row.attitude_deg), limits.model_range_deg
    )
    # a less certain angle is used where something is lost by waiting
    found["protection_level"] = ConditionValue(
        _PROTECTION, level_deg, max(alert_deg, DOUBT_RATIO * nominal_deg) if is_urgent else alert_deg
    )
    is_judged = row.method is Method.ROBUST and not is_urgent
    sigmas = {"roll": limits.roll_sigma_limit_deg, "pitch": limits.pitch_sigma_limit_deg}
    for axis, limit_deg in sigmas.items():
        measure = Measure(f"sigma of {axis}", "deg")
        found[f"sigma_{axis}"] = ConditionValue(
            measure,
            getattr(row.sigma_deg, axis),
            limit_deg if is_judged else math.nan,
        )
    return found


def _unjudged(view: ControlView | None, verdict: ControlVerdict) -> set[str]:
    """Return the codes that nothing is known to judge by, or that another reason comes before."""
    codes = {reason.code for reason in verdict.reasons}
    # a computed command passes no check of the interlock: its row judges yaw
    is_automatic = view is not None and view.release is Release.AUTOMATIC
    unjudged = {code for code, each in CONDITIONS.items() if is_automatic and each.consequence is Consequence.YAW}
    if view is None:
        unjudged.update(CONDITIONS, ("not_armed", "good_minutes"))
    elif not verdict.is_allowed:
        if not view.has_row:
            unjudged.update(condition.word for condition in OF_ROW)
        if not view.is_armed:
            unjudged.add("not_armed")
        if view.good_minutes.elapsed_s < view.good_minutes.needed_s:
            unjudged.add("good_minutes")
        # the row's own reasons stand in its place
        unjudged.update(reason.code for reason in view.reasons)
    if "no_attitude" in codes:
        unjudged |= {*INHIBITIONS, *CONTROL_INHIBITIONS, "expired", "invalid"} - set(CONDITIONS)
    return unjudged
