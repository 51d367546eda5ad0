"""The pulses of one command: a slew that ends without a rate, then rare pulses against a torque that is known.

A spacecraft behind a link cannot be asked again at once, so a command holds for its whole horizon: the slew of
`tracking.tracking_request` within its first part, and from there on pulses that hold the spacecraft where the slew has
left it. What is too much for the envelope is asked for in smaller steps: first the horizon becomes shorter, then the
slew. Nothing is cut afterwards. Order everywhere: yaw, roll, pitch.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray
from service.core.control.quaternion_law import Gains, tracking_request
from service.core.control.slew_schedule import LONGEST_SHARE, AxisPulse, Drive, Envelope, plan_slew

#: yaw beyond it settles with roll and pitch how long a command holds, deg
_YAW_COUNTS_DEG = 0.3


class Situation(NamedTuple):
    """The spacecraft when the command begins; (3,) each."""

    attitude_deg: FloatArray
    rates_deg_s: FloatArray
    #: axes about which nothing may be commanded are False
    is_allowed: BoolArray


class Forecast(NamedTuple):
    """Division of a command in time, and the known disturbance torque in each part."""

    slew_s: float
    slice_s: float
    #: (1 + K, 3) N m: mean over the slew and over each slice after it
    torque_n_m: FloatArray
    #: s; the envelope holds until then also where fewer slices follow the slew
    least_horizon_s: float = 0.0

    @property
    def slices(self) -> int:
        """Number of slices K."""
        return len(self.torque_n_m) - 1

    def envelope_horizon_s(self, slices: int) -> float:
        """Return until when a command with so many slices must keep to the envelope."""
        return max(self.slew_s + slices * self.slice_s, self.least_horizon_s)


class PlannedPulses(NamedTuple):
    """Pulses of a command."""

    #: in order of time
    pulses: tuple[AxisPulse, ...]
    #: until then it holds
    horizon_s: float
    #: whether the envelope made the slew smaller than the law wanted it
    is_shortened: bool


class _Request(NamedTuple):
    """Angle and rate that the pulses of the slew shall change; (3,) rad and rad/s."""

    change_rad: FloatArray
    rate_rad_s: FloatArray


def plan_command(
    gains: Gains, drive: Drive, situation: Situation, forecast: Forecast, envelope: Envelope
) -> PlannedPulses:
    """Return the pulses of a command.

    Parameters
    ----------
    gains : Gains
        Of `quaternion_law.loop_gains`.
    drive : Drive
        Limit, quantum, shortest pulse and grid.
    situation : Situation
        Angles, rates and what may be commanded.
    forecast : Forecast
        The slew's time, and the torque to be balanced.
    envelope : Envelope
        What the command may change at most against no command, until its horizon ends.

    Raises
    ------
    ValueError
        A number is not finite, or the drive cannot give the slew in its time.

    Notes
    -----
    When the slew ends the spacecraft has no rate and the torque has been balanced until then; after each slice angle
    and rate are back, but for what the shortest pulse cannot express, which the next slice takes.
    """
    if not np.isfinite(forecast.torque_n_m).all():
        raise ValueError("the torque to be balanced must be finite")
    request = _request_of(gains, situation, forecast)
    counts = (abs(float(situation.attitude_deg[0])) > _YAW_COUNTS_DEG, True, True)
    fitted, slices = _fitted(request, gains.inertia_kg_m2.diagonal(), forecast, envelope, counts)
    horizon_s = forecast.slew_s + slices * forecast.slice_s
    slew = plan_slew(
        np.degrees(fitted.change_rad), np.degrees(fitted.rate_rad_s), gains.inertia_kg_m2, forecast.slew_s, drive
    )
    pulses = [pulse for pulse in slew if situation.is_allowed[pulse.axis]]
    left_n_m_s = gains.inertia_kg_m2 @ fitted.rate_rad_s
    for pulse in pulses:
        left_n_m_s[pulse.axis] += pulse.impulse_n_m_s
    for axis in np.flatnonzero(situation.is_allowed).tolist():
        torques = forecast.torque_n_m[1 : slices + 1, axis].tolist()
        pulses += _balancing(axis, float(left_n_m_s[axis]), torques, forecast, drive)
    is_shortened = bool(np.abs(fitted.change_rad - request.change_rad).max() > 1e-12)
    return PlannedPulses(tuple(sorted(pulses, key=lambda pulse: (pulse.start_s, pulse.axis))), horizon_s, is_shortened)


def _request_of(gains: Gains, situation: Situation, forecast: Forecast) -> _Request:
    """Return the request of the pulses: the law's slew, and the effect of the disturbance torque until its end."""
    slew = tracking_request(gains, situation.attitude_deg, situation.rates_deg_s, forecast.slew_s)
    change, rate = np.radians(slew.angle_change_deg), np.radians(slew.rate_deg_s)
    if forecast.torque_n_m[0].any():
        pushed_rad_s2 = np.linalg.solve(gains.inertia_kg_m2, forecast.torque_n_m[0])
        change = change + 0.5 * pushed_rad_s2 * forecast.slew_s**2
        rate = rate + pushed_rad_s2 * forecast.slew_s
    return _Request(np.where(situation.is_allowed, change, 0.0), np.where(situation.is_allowed, rate, 0.0))


class _AxisRequest(NamedTuple):
    """Request about one axis, rad and rad/s; plain numbers, which cost a tenth of arrays of three."""

    change_rad: float
    rate_rad_s: float
    inertia_kg_m2: float
    #: N m, of each slice
    torques_n_m: list[float]
    #: whether it settles how long the command may hold
    counts: bool


def _fitted(
    request: _Request, inertia: FloatArray, forecast: Forecast, envelope: Envelope, counts: tuple[bool, bool, bool]
) -> tuple[_Request, int]:
    """Return a wish inside the envelope and how many slices may follow it.

    The axes that count (3,) settle how long the command may hold. Yaw, known ten times worse than roll and pitch, makes
    do with what is left until it is far off: a torque of 1e-6 N m leaves nothing to it in an hour.
    """
    numbers = (values.tolist() for values in (*request, inertia, forecast.torque_n_m[1:].T))
    axes = [_AxisRequest(*each) for each in zip(*numbers, counts, strict=True)]
    slices = forecast.slices
    while slices and not all(_has_room(axis, forecast, slices, envelope) for axis in axes):
        slices -= 1
    change, rate = zip(*(_limited(axis, forecast, slices, envelope) for axis in axes), strict=True)
    return _Request(np.array(change), np.array(rate)), slices


def _has_room(axis: _AxisRequest, forecast: Forecast, slices: int, envelope: Envelope) -> bool:
    """Return whether the envelope has room for some slices, and where the axis counts for its request before them."""
    if not axis.counts:
        gross, turned = _balance(axis, forecast, slices)
        room = envelope.impulse_n_m_s / axis.inertia_kg_m2
        return gross <= room and abs(turned) <= math.radians(envelope.angle_change_deg)
    lower, upper = _bounds(axis, axis.rate_rad_s, forecast, slices, envelope)
    return lower <= axis.change_rad <= upper


def _limited(axis: _AxisRequest, forecast: Forecast, slices: int, envelope: Envelope) -> tuple[float, float]:
    """Return change and rate of the part of a request that the envelope has room for."""
    horizon_s = forecast.envelope_horizon_s(slices)
    gross, turned = _balance(axis, forecast, slices)
    # the greatest rate that any slew may lose
    greatest = min(
        math.radians(envelope.rate_change_deg_s),
        envelope.impulse_n_m_s / axis.inertia_kg_m2 - gross,
        (math.radians(envelope.angle_change_deg) - abs(turned)) / horizon_s,
    )
    rate = min(max(axis.rate_rad_s, -max(greatest, 0.0)), max(greatest, 0.0))
    lower, upper = _bounds(axis, rate, forecast, slices, envelope)
    return min(max(axis.change_rad, lower), max(lower, upper)), rate


def _balance(axis: _AxisRequest, forecast: Forecast, slices: int) -> tuple[float, float]:
    """Return the sum of the rates that balancing gives, rad/s, and what they turn until the horizon, rad."""
    horizon_s = forecast.envelope_horizon_s(slices)
    gross = turned = 0.0
    for number, torque_n_m in enumerate(axis.torques_n_m[:slices]):
        given = torque_n_m * forecast.slice_s / axis.inertia_kg_m2
        gross += abs(given)
        turned += given * (horizon_s - (forecast.slew_s + forecast.slice_s * (number + 0.5)))
    return gross, turned


def _bounds(
    axis: _AxisRequest, rate: float, forecast: Forecast, slices: int, envelope: Envelope
) -> tuple[float, float]:
    """Return the least and greatest change of the slew, rad, with which a command keeps to the envelope.

    With x = change over the time between its pulses, the first one gives the rate x - rate, the second one takes x;
    until the horizon ends they turn the spacecraft by change - rate * horizon, the slices by their own part.
    """
    apart_s = (1.0 - LONGEST_SHARE) * forecast.slew_s
    horizon_s = forecast.envelope_horizon_s(slices)
    gross, turned = _balance(axis, forecast, slices)
    angle, step = math.radians(envelope.angle_change_deg), math.radians(envelope.rate_change_deg_s)
    room = envelope.impulse_n_m_s / axis.inertia_kg_m2 - gross
    lower = max(
        -angle + rate * horizon_s + turned,
        -angle + rate * forecast.slew_s,
        apart_s * (rate - step),
        apart_s * (rate - room) / 2.0,
    )
    upper = min(
        angle + rate * horizon_s + turned,
        angle + rate * forecast.slew_s,
        apart_s * (rate + step),
        apart_s * (rate + room) / 2.0,
    )
    return lower, upper


def _balancing(
    axis: int, left_n_m_s: float, torques_n_m: list[float], forecast: Forecast, drive: Drive
) -> Iterator[AxisPulse]:
    """Yield the pulses that hold an axis against a torque, one at the beginning of each slice and one at the end."""
    momentum, angle = left_n_m_s, 0.0
    slice_s = forecast.slice_s
    for number, torque in enumerate(torques_n_m):
        wanted = -0.5 * torque * slice_s - angle / slice_s - momentum
        pulse = _pulse(axis, forecast.slew_s + number * slice_s, wanted, slice_s, drive)
        if pulse is not None:
            momentum += pulse.impulse_n_m_s
            yield pulse
        angle += momentum * slice_s + 0.5 * torque * slice_s**2
        momentum += torque * slice_s
    if torques_n_m:
        stop_s = forecast.slew_s + len(torques_n_m) * slice_s
        last = _pulse(axis, stop_s, -momentum, slice_s, drive)
        if last is not None:
            yield last._replace(start_s=stop_s - last.duration_s)


def _pulse(axis: int, start_s: float, impulse_n_m_s: float, slice_s: float, drive: Drive) -> AxisPulse | None:
    """Return the pulse nearest to an impulse; None where that is none."""
    # of two pulses in a slice, at its beginning and at its end, none may reach the other
    steps = max(1, math.ceil(abs(impulse_n_m_s) / (drive.quantum_n_m * LONGEST_SHARE * slice_s)))
    torque = min(steps, drive.steps_at_limit) * drive.quantum_n_m
    ideal_s = min(abs(impulse_n_m_s) / torque, LONGEST_SHARE * slice_s)
    duration_s = round(ideal_s / drive.time_step_s) * drive.time_step_s
    if duration_s < drive.min_pulse_s / 2.0:
        return None
    return AxisPulse(axis, start_s, max(duration_s, drive.min_pulse_s), math.copysign(torque, impulse_n_m_s))
