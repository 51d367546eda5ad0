"""Conditions of the control verdict, met and not met, with value and limit.

Law of this file: nothing is judged here. A condition is not met where the verdict names it, and only there.
"""

import math
from dataclasses import dataclass
from typing import Annotated

from service.core.estimation.filtering.integrity import DOUBT_RATIO, WAITING_LOSS_DEG
from service.pipeline.config import InterlockConfig
from service.pipeline.control.command.control_design import CONTROL_INHIBITIONS
from service.pipeline.control.release.control_verdict import (
    CONDITIONS,
    OTHER_REASONS,
    ConditionValue,
    ControlVerdict,
    ControlView,
)
from service.pipeline.control.release.interlock_conditions import (
    MEASURES,
    OF_ROW,
    Condition,
    Consequence,
    Measure,
    greater_angle_deg,
)
from service.pipeline.estimation.row_inhibitions import INHIBITIONS
from service.records.catalogue import Method, Release
from service.records.levels.attitude import AttitudeRow, row_without_attitude

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
