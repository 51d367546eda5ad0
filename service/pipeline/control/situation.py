"""Situation of a spacecraft: the worst that is true now, which every view says first.

Order: the estimator fails; no row; the newest row is old; the attitude is lost; an angle is beyond its limit, or grows
towards it, whatever control does; then what is known of the angles. Rows that come while no carrier is received are
not old: what they lack is the carriers. The law of this file: one severity for one situation, and
nothing is called known that is old, lost or beyond the range of the model.

The rate of an axis is the slope of its angles over the last half hour, for the filter hardly follows an unexpected
motion: of a drift of 0.6 deg/h it shows 0.02 after an hour, the slope 0.3 after a quarter of an hour and all after half
an hour. Against the true slope the filter's rate of roll and pitch errs by 0.023 to 0.19 deg/h, the slope by 0.014 to
0.025 (scenarios ``white`` and ``octants``).
What was commanded goes on no more once it is done: a turn of 0.25 deg that was over read as 0.4 to 0.7 deg/h for half
an hour, so the slope begins at its end.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from service.pipeline.control.release.command_states import State
from service.pipeline.control.release.control_verdict import ControlVerdict
from service.records.epoch import US_PER_S
from service.records.levels.attitude import AttitudeRow, Axes, Status, named_axes

#: codes of situations, the worst first
SITUATIONS = (
    *("estimator_failed", "no_attitude", "old", "dark", "lost", "no_angles", "beyond_and_growing", "beyond_limit"),
    *("towards_limit", "known"),
)
_AXES = ("yaw", "roll", "pitch")
#: an angle that reaches its limit within a command period of two hours is named, from half of the limit on
_SOON_H, _NEAR_SHARE = 2.0, 0.5
#: two sigma of the slope; a slower rate is none, deg/h
_LEAST_DEG_H = 0.05
#: a limit that is met later is not met
_FAR_H = 24.0
#: rates are the slope of the angles over this time
RATE_WINDOW_S = 1800.0
_LEAST_ROWS = 3
#: yaw, which powers tell badly, is called beyond its limit when it surely is
_YAW_SIGMAS = 2.0
#: "known to" without a protection level
_SIGMAS = 2.0


@dataclass(frozen=True, slots=True)
class AxisMotion:
    """An axis and its way to the limit; rate and time of a row that is old or lost are not known."""

    #: yaw, roll or pitch
    axis: str
    angle_deg: Annotated[float, "The last known where it is lost."]
    is_beyond: Annotated[bool, "It is beyond its limit; yaw: surely, by two sigma."]
    rate_deg_h: Annotated[
        float,
        "Slope of the angle over the last half hour, or since a commanded motion; without rows for it the estimator's.",
    ] = math.nan
    hours_to_limit: Annotated[float, "At this rate, of either sign; null: not within a day."] = math.nan

    @property
    def outward_deg_h(self) -> float:
        """Rate away from zero."""
        return math.copysign(1.0, self.angle_deg) * self.rate_deg_h


@dataclass(frozen=True, slots=True)
class SpacecraftSituation:
    """The worst that is true of a spacecraft now."""

    code: Annotated[str, "Dark: no carrier is on the air; no_angles: of a first row; old: the newest row is."]
    severity: Annotated[str, "critical, serious, caution or normal; that of every view."]
    axis: Annotated[str | None, "Of old, dark, lost and what is said of a limit."] = None
    angle_deg: Annotated[float, "Of this axis; the last known where it is old or lost."] = math.nan
    limit_deg: Annotated[float, "An angle is to stay within it."] = math.nan
    rate_deg_h: Annotated[float, "Positive: away from zero."] = math.nan
    hours_to_limit: Annotated[float, "At this rate; null: it does not go there."] = math.nan
    known_deg: Annotated[
        float, "Roll and pitch are known to it: the greater protection level, of a method without one two sigma."
    ] = math.nan
    yaw_known_deg: Annotated[float, "The same of yaw."] = math.nan
    axes: Annotated[tuple[AxisMotion, ...], "Every axis whose angle is known."] = ()


def recent_rate(rows: Sequence[AttitudeRow]) -> Axes | None:
    """Return the slope of the angles, deg/s, of rows in order of epoch; None: they cover less than ten minutes.

    An alignment may move the angles, so the rows are those under the newest row's.
    """
    known = [row for row in rows if row.status is Status.ACQUIRED and row.alignment_id == rows[-1].alignment_id]
    if len(known) < _LEAST_ROWS or known[-1].epoch_us - known[0].epoch_us < RATE_WINDOW_S / 3.0 * US_PER_S:
        return None
    time_s = np.array([row.epoch_us - known[-1].epoch_us for row in known]) / US_PER_S
    slope_deg_s, _ = np.polyfit(time_s - time_s.mean(), np.array([row.steered_deg for row in known]), 1)
    return named_axes(slope_deg_s)


def situation_of(
    row: AttitudeRow | None, verdict: ControlVerdict, limit_deg: float, rate: Axes | None = None
) -> SpacecraftSituation:
    """Return the situation.

    Parameters
    ----------
    row : AttitudeRow or None
        Newest row of the method that drives control, as it holds now.
    verdict : ControlVerdict
        On control.
    limit_deg : float, deg
        Angle within which roll, pitch and yaw are to stay.
    rate : Axes, optional, deg/s
        Of `recent_rate`; None: the row's.
    """
    if row is None:
        return _worst(row, verdict, (), limit_deg)
    has_failed = any(reason.code == "estimator_failed" for reason in verdict.reasons)
    is_known = row.status is Status.ACQUIRED and not has_failed
    axes = tuple(_motions(row, limit_deg, (rate or row.rates_deg_s) if is_known else None))
    return replace(_worst(row, verdict, axes, limit_deg), axes=axes)


def _worst(
    row: AttitudeRow | None, verdict: ControlVerdict, axes: tuple[AxisMotion, ...], limit_deg: float
) -> SpacecraftSituation:
    codes = {reason.code for reason in verdict.reasons}
    if "estimator_failed" in codes:
        return SpacecraftSituation("estimator_failed", "critical")
    if row is None:
        return SpacecraftSituation("no_attitude", "serious")
    if not axes:
        # a first row without angles has lost nothing
        return SpacecraftSituation("no_angles", "serious")
    farthest = max(axes, key=lambda each: (each.is_beyond, abs(each.angle_deg)))
    if "expired" in row.inhibitions:
        # within its limits when it was last seen
        severity = "critical" if farthest.is_beyond else "serious"
        return replace(_of_axis("old", farthest, limit_deg), severity=severity)
    if row.status is not Status.ACQUIRED:
        is_dark = row.carriers_used == 0 and {each.reason for each in row.excluded} == {"absent"}
        return _of_axis("dark" if is_dark else "lost", farthest, limit_deg)
    if farthest.is_beyond:
        is_growing = farthest.outward_deg_h > _LEAST_DEG_H
        return _of_axis("beyond_and_growing" if is_growing else "beyond_limit", farthest, limit_deg)
    if soon := [each for each in axes if _is_soon(each, limit_deg)]:
        soonest = min(soon, key=lambda each: each.hours_to_limit)
        return replace(_of_axis("towards_limit", soonest, limit_deg), severity="serious")
    known_deg, yaw_known_deg = _known_deg(row)
    return SpacecraftSituation("known", _severity(verdict), known_deg=known_deg, yaw_known_deg=yaw_known_deg)


def _severity(verdict: ControlVerdict) -> str:
    """Return the severity of what control does while the angles are known and within their limits."""
    if verdict.is_allowed:
        return "caution" if verdict.reasons else "normal"
    return "critical" if verdict.state == State.TRIPPED.name else "serious"


def _of_axis(code: str, motion: AxisMotion, limit_deg: float) -> SpacecraftSituation:
    rate_deg_h, hours = motion.outward_deg_h, motion.hours_to_limit
    return SpacecraftSituation(code, "critical", motion.axis, motion.angle_deg, limit_deg, rate_deg_h, hours)


def _is_soon(motion: AxisMotion, limit_deg: float) -> bool:
    """Return whether an angle that is not small grows to its limit soon."""
    # roll and pitch alone: yaw's rate is as uncertain as yaw
    is_near = motion.axis != "yaw" and abs(motion.angle_deg) > _NEAR_SHARE * limit_deg
    return is_near and motion.outward_deg_h > 0.0 and motion.hours_to_limit <= _SOON_H


def _motions(row: AttitudeRow, limit_deg: float, rates_deg_s: Axes | None) -> Iterator[AxisMotion]:
    """Yield each axis whose angle is known, with its way to the limit."""
    for axis in _AXES:
        angle_deg = getattr(row.steered_deg, axis)
        if not math.isfinite(angle_deg):
            continue
        rate_deg_h = math.nan if rates_deg_s is None else 3600.0 * getattr(rates_deg_s, axis)
        least_deg = abs(angle_deg) - (_YAW_SIGMAS * row.steered_sigma_deg.yaw if axis == "yaw" else 0.0)
        hours = (math.copysign(limit_deg, rate_deg_h) - angle_deg) / rate_deg_h if rate_deg_h else math.inf
        hours = hours if 0.0 < hours < _FAR_H else math.nan
        yield AxisMotion(axis, angle_deg, least_deg > limit_deg, rate_deg_h, hours)


def _known_deg(row: AttitudeRow) -> tuple[float, float]:
    """Return to what roll and pitch, and yaw, are known, rounded up: never better than it is."""
    has_levels = all(map(math.isfinite, row.protection_deg))
    yaw, roll, pitch = row.protection_deg if has_levels else [_SIGMAS * sigma for sigma in row.steered_sigma_deg]
    return _rounded_up(max(roll, pitch)), _rounded_up(yaw)


def _rounded_up(value: float) -> float:
    return math.ceil(100.0 * value - 1e-9) / 100.0 if math.isfinite(value) else math.nan
