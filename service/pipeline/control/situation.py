"""Situation of a spacecraft: the worst that is true now, which every view says first.

Order: the estimator fails; no row; rows are old; the attitude is lost; an angle is beyond its limit, or grows towards
it, whatever control does; then what is known of the angles. The law of this file: one severity for one situation, and
nothing is called known that is old, lost or beyond the range of the model.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated

from service.pipeline.control.release.command_states import State
from service.pipeline.control.release.control_verdict import ControlVerdict
from service.records.levels.attitude import AttitudeRow, Status

#: codes of situations, the worst first
SITUATIONS = (
    *("estimator_failed", "no_attitude", "old", "dark", "lost", "no_angles", "beyond_and_growing", "beyond_limit"),
    *("towards_limit", "known"),
)
_AXES = ("yaw", "roll", "pitch")
#: an angle that reaches its limit within a command period of two hours is named, from half of the limit on
_SOON_H, _NEAR_SHARE = 2.0, 0.5
#: a slower rate is none, deg/h
_LEAST_DEG_H = 0.01
#: yaw, which powers tell badly, is called beyond its limit when it surely is
_YAW_SIGMAS = 2.0
#: "known to" without a protection level
_SIGMAS = 2.0


@dataclass(frozen=True, slots=True)
class SpacecraftSituation:
    """The worst that is true of a spacecraft now."""

    code: Annotated[str, "Dark: no carrier is on the air; no_angles: of a first row; old: the newest row is."]
    severity: Annotated[str, "critical, serious, caution or normal; that of every view."]
    axis: Annotated[str | None, "Of dark, lost and what is said of a limit."] = None
    angle_deg: Annotated[float, "Of this axis; the last known where it is lost."] = math.nan
    limit_deg: Annotated[float, "An angle is to stay within it."] = math.nan
    rate_deg_h: Annotated[float, "Positive: away from zero."] = math.nan
    hours_to_limit: Annotated[float, "At this rate; null: it does not go there."] = math.nan
    known_deg: Annotated[
        float, "Roll and pitch are known to it: the greater protection level, of a method without one two sigma."
    ] = math.nan
    yaw_known_deg: Annotated[float, "The same of yaw."] = math.nan


def situation_of(row: AttitudeRow | None, verdict: ControlVerdict, limit_deg: float) -> SpacecraftSituation:
    """Return the situation.

    Parameters
    ----------
    row : AttitudeRow or None
        Newest row of the method that drives control, as it holds now.
    verdict : ControlVerdict
        On control.
    limit_deg : float, deg
        Angle within which roll, pitch and yaw are to stay.
    """
    codes = {reason.code for reason in verdict.reasons}
    if "estimator_failed" in codes:
        return SpacecraftSituation("estimator_failed", "critical")
    if row is None:
        return SpacecraftSituation("no_attitude", "serious")
    if "expired" in codes:
        return SpacecraftSituation("old", "serious")
    motions = list(_motions(row, limit_deg))
    if row.status is not Status.ACQUIRED:
        if not motions:
            # a first row without angles has lost nothing
            return SpacecraftSituation("no_angles", "serious")
        is_dark = row.carriers_used == 0 and {each.reason for each in row.excluded} == {"absent"}
        worst = max(motions, key=lambda each: abs(each.angle_deg))
        return replace(worst, code="dark" if is_dark else "lost", hours_to_limit=math.nan)
    beyond = [each for each in motions if _least_deg(each, row) > limit_deg]
    if beyond:
        worst = max(beyond, key=lambda each: abs(each.angle_deg))
        return replace(worst, code="beyond_and_growing" if worst.rate_deg_h > _LEAST_DEG_H else "beyond_limit")
    growing = [each for each in motions if each.hours_to_limit <= _SOON_H]
    if growing:
        soonest = min(growing, key=lambda each: each.hours_to_limit)
        return replace(soonest, code="towards_limit", severity="serious")
    known_deg, yaw_known_deg = _known_deg(row)
    return SpacecraftSituation("known", _severity(verdict), known_deg=known_deg, yaw_known_deg=yaw_known_deg)


def _severity(verdict: ControlVerdict) -> str:
    """Return the severity of what control does while the angles are known and within their limits."""
    if verdict.is_allowed:
        return "caution" if verdict.reasons else "normal"
    return "critical" if verdict.state == State.TRIPPED.name else "serious"


def _motions(row: AttitudeRow, limit_deg: float) -> Iterator[SpacecraftSituation]:
    """Return each axis whose angle is known, with its way to the limit."""
    for axis in _AXES:
        angle_deg = getattr(row.attitude_deg, axis)
        if not math.isfinite(angle_deg):
            continue
        rate_deg_h = math.nan
        if row.rates_deg_s is not None:
            rate_deg_h = 3600.0 * math.copysign(1.0, angle_deg) * getattr(row.rates_deg_s, axis)
        left_deg = limit_deg - abs(angle_deg)
        # roll and pitch alone: yaw's rate is as uncertain as yaw
        is_going = axis != "yaw" and rate_deg_h > 0.0 and 0.0 < left_deg < (1.0 - _NEAR_SHARE) * limit_deg
        hours = left_deg / rate_deg_h if is_going else math.nan
        yield SpacecraftSituation("", "critical", axis, angle_deg, limit_deg, rate_deg_h, hours)


def _least_deg(motion: SpacecraftSituation, row: AttitudeRow) -> float:
    """Return how far from zero an axis surely is."""
    doubt_deg = _YAW_SIGMAS * row.sigma_deg.yaw if motion.axis == "yaw" else 0.0
    return abs(motion.angle_deg) - doubt_deg


def _known_deg(row: AttitudeRow) -> tuple[float, float]:
    """Return to what roll and pitch, and yaw, are known, rounded up: never better than it is."""
    has_levels = all(map(math.isfinite, row.protection_deg))
    yaw, roll, pitch = row.protection_deg if has_levels else [_SIGMAS * sigma for sigma in row.sigma_deg]
    return _rounded_up(max(roll, pitch)), _rounded_up(yaw)


def _rounded_up(value: float) -> float:
    return math.ceil(100.0 * value - 1e-9) / 100.0 if math.isfinite(value) else math.nan
