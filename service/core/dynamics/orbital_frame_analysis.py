"""Flights of the spacecraft in the orbital frame: start, seeded noise, record in degrees, measures of the record.

Angles and rates are in the axes of the package (z up, y along the orbit normal), named roll, pitch, yaw.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.dynamics.orbital_frame_kernel import NO_YAW_ESTIMATE, Fly, fly
from service.core.dynamics.orbital_frame_model import OrbitalFrameSpacecraft, VerticalSensor, refusals
from service.core.dynamics.orbital_frame_step import State

#: longest flight, periods of the computer: a record of 350 MB
MAX_PERIODS = 4_000_000


class Start(NamedTuple):
    """Attitude at the start, deg, and how the momentum of the orbital motion lies in the body."""

    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    #: the orbital rate taken literally along the body's y, as the paper has it; else turned with the attitude
    is_literal: bool = True
    #: inertial rate of the body in place of the orbital one, rad/s; roll, pitch, yaw
    rate_rad_s: tuple[float, float, float] | None = None


class FlightRecord(NamedTuple):
    """Record of a flight; one row a period of the computer, the start first."""

    #: (T,) s
    time_s: FloatArray
    roll_deg: FloatArray
    pitch_deg: FloatArray
    yaw_deg: FloatArray
    #: (T, 3) N m on the body about roll, pitch, yaw; that of the period before
    torque_n_m: FloatArray
    #: (T, 3) N m s of the wheels
    momentum_n_m_s: FloatArray
    #: (T,) measured roll rate over orbital rate
    rate_ratio: FloatArray
    end: State


def fly_spacecraft(
    spacecraft: OrbitalFrameSpacecraft, start: Start, duration_s: float, seed: int = 1, kernel: Fly = fly
) -> FlightRecord:
    """Return a flight.

    Parameters
    ----------
    spacecraft : OrbitalFrameSpacecraft
        Bodies, wheels, sensors and law.
    start : Start
        Initial angles and rates.
    duration_s : float, s
        Rounded to periods of the computer.
    seed : int
        Of the sensors' noise; the same seed gives the same flight.
    kernel : callable
        ``fly`` or ``compiled_fly()``; they agree to rounding.

    Returns
    -------
    FlightRecord

    Raises
    ------
    ValueError
        The spacecraft cannot be, the duration is none, or a roll rate above sqrt(2) of the orbital one left the printed
        law without a yaw (its nu0 is imaginary); the text says which and what to do.
    """
    wrong = refusals(spacecraft)
    periods = round(duration_s / spacecraft.computer.period_s) if not wrong and math.isfinite(duration_s) else 0
    if wrong or not 1 <= periods <= MAX_PERIODS:
        raise ValueError("; ".join(wrong) or f"a duration of {duration_s:g} s is not 1 to {MAX_PERIODS} periods")
    rng = np.random.default_rng(seed)
    rate_noise = spacecraft.rate_sensor.noise_rad_s * rng.standard_normal((periods, 3))
    tilt_noise = _coloured(spacecraft.vertical_sensor, rng.standard_normal((periods, 2)), spacecraft.computer.period_s)
    record = np.zeros((periods + 1, 11))
    status, flown, end = kernel(
        spacecraft, _state(spacecraft, start), tone_steps(spacecraft), rate_noise, tilt_noise, record
    )
    if status == NO_YAW_ESTIMATE:
        ratio = record[flown, 10]
        raise ValueError(
            f"after {flown * spacecraft.computer.period_s:.3f} s the roll rate is {ratio:.2f} orbital rates or more "
            "and nu0 of the printed law is imaginary; take the guarded law, or stop the roll first"
        )
    degrees = np.degrees(record[:, 1:4])
    return FlightRecord(
        record[:, 0], degrees[:, 0], degrees[:, 1], degrees[:, 2], record[:, 4:7], record[:, 7:10], record[:, 10], end
    )


def _state(spacecraft: OrbitalFrameSpacecraft, start: Start) -> State:
    """Return quaternion, momentum and wheels at the start."""
    roll, pitch, yaw = (0.5 * math.radians(angle) for angle in start[:3])
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    q0, q1 = cy * cp * cr + sy * sp * sr, cy * cp * sr - sy * sp * cr
    q2, q3 = cy * sp * cr + sy * cp * sr, sy * cp * cr - cy * sp * sr
    w0 = spacecraft.law.orbital_rate_rad_s
    along = (0.0, 1.0, 0.0)
    if not start.is_literal:
        along = (2.0 * (q1 * q2 + q0 * q3), q0**2 - q1**2 + q2**2 - q3**2, 2.0 * (q2 * q3 - q0 * q1))
    rate = np.array(start.rate_rad_s or [w0 * each for each in along])
    j = spacecraft.inertia
    momentum = np.array([[j.xx, j.xy, j.xz], [j.xy, j.yy, j.yz], [j.xz, j.yz, j.zz]]) @ rate
    return (q0, q1, q2, q3, float(momentum[0]), float(momentum[1]), float(momentum[2]), 0.0, 0.0, 0.0)


def _coloured(sensor: VerticalSensor, white: FloatArray, period_s: float) -> FloatArray:
    """Return stationary noise of one time constant, rad, shape (T, 2), from white noise of unit variance."""
    from scipy.signal import lfilter

    keep = math.exp(-period_s / sensor.noise_time_s)
    scale = math.sqrt(1.0 - keep**2)
    coloured, _ = lfilter([scale], [1.0, -keep], white[1:], axis=0, zi=keep * white[:1])
    return sensor.noise_rad * np.concatenate([white[:1], coloured])


def tone_steps(spacecraft: OrbitalFrameSpacecraft) -> FloatArray:
    """Return the exact step of each flexible tone under a constant torque, shape (6, 6).

    Columns: the matrix of angle and rate, row by row, and what one newton metre adds to angle and rate.
    """
    tones, h = spacecraft.tones, spacecraft.computer.period_s / spacecraft.steps
    steps = np.zeros((6, 6))
    for k in range(6):
        omega = 2.0 * math.pi * (*tones.roll_hz, *tones.yaw_hz)[k]
        inertia = spacecraft.inertia.xx if k < 3 else spacecraft.inertia.zz
        zeta, static = tones.damping_ratio, tones.gains[k % 3] / inertia / omega**2
        damped = omega * math.sqrt(1.0 - zeta**2)
        fade, c, s = math.exp(-zeta * omega * h), math.cos(damped * h), math.sin(damped * h)
        a11, a12 = fade * (c + zeta * omega / damped * s), fade * s / damped
        a21, a22 = -(omega**2) * a12, fade * (c - zeta * omega / damped * s)
        steps[k] = a11, a12, a21, a22, static * (1.0 - a11), -static * a21
    return steps


def largest_after(flight: FlightRecord, time_s: float) -> tuple[float, float, float]:
    """Return the largest size of roll, pitch and yaw after a time, deg."""
    late = flight.time_s > time_s
    return tuple(float(np.abs(angle[late]).max()) for angle in (flight.roll_deg, flight.pitch_deg, flight.yaw_deg))  # type: ignore[return-value]  # three angles


def time_within(time_s: FloatArray, angle_deg: FloatArray, bound_deg: float) -> float:
    """Return from when on an angle stays within a bound, s; NaN when it does not at the end.

    Examples
    --------
    >>> time_within(np.arange(4.0), np.array([2.0, 0.05, 0.2, 0.01]), 0.1)
    3.0
    """
    outside = np.flatnonzero(np.abs(angle_deg) > bound_deg)
    if not len(outside):
        return float(time_s[0])
    return float(time_s[outside[-1] + 1]) if outside[-1] + 1 < len(time_s) else math.nan


def harmonic_amplitude(time_s: FloatArray, angle_deg: FloatArray, period_s: float) -> float:
    """Return the amplitude of the harmonic of a period in an angle, by least squares beside a constant and a trend."""
    phase = 2.0 * math.pi * time_s / period_s
    design = np.column_stack([np.cos(phase), np.sin(phase), np.ones_like(phase), time_s - time_s.mean()])
    solved = np.linalg.lstsq(design, angle_deg, rcond=None)[0]
    return float(np.hypot(solved[0], solved[1]))


def mean_over_orbits(flight: FlightRecord, orbital_rate_rad_s: float, orbits: int = 2) -> float:
    """Return the mean yaw of the last whole orbits, deg; what comes and goes with the orbit leaves no mark on it."""
    late = flight.time_s > flight.time_s[-1] - orbits * 2.0 * math.pi / orbital_rate_rad_s
    return float(flight.yaw_deg[late].mean())


def trimmed_correction_rad_s(
    spacecraft: OrbitalFrameSpacecraft, duration_s: float, kernel: Fly = fly, seed: int = 1
) -> float:
    """Return the correction of the measured yaw rate that brings the mean yaw to zero, by the secant rule.

    What an operator does over some orbits: friction of the yaw wheel turns the spacecraft, and the yaw rate's zero is
    moved until it no longer does. The flight lasts two orbits beside its transient, over which the mean is taken.
    """
    tried: list[tuple[float, float]] = []
    correction = 0.0
    for _ in range(8):
        flown = fly_spacecraft(_corrected(spacecraft, correction), Start(), duration_s, seed, kernel)
        mean_deg = mean_over_orbits(flown, spacecraft.law.orbital_rate_rad_s)
        tried.append((correction, mean_deg))
        if abs(mean_deg) < 5e-4:
            break
        # a rate offset turns yaw by k2 sqrt(2) / k1 for each unit; measured slopes take over from the second trial on
        slope = -math.degrees(spacecraft.law.gains.yaw_damping * math.sqrt(2.0) / spacecraft.law.gains.yaw_stiffness)
        if len(tried) > 1 and tried[-1][0] != tried[-2][0]:
            slope = (tried[-1][1] - tried[-2][1]) / (tried[-1][0] - tried[-2][0])
        correction -= mean_deg / slope
    return min(tried, key=lambda trial: abs(trial[1]))[0]


def _corrected(spacecraft: OrbitalFrameSpacecraft, correction_rad_s: float) -> OrbitalFrameSpacecraft:
    return spacecraft._replace(computer=spacecraft.computer._replace(yaw_rate_correction_rad_s=correction_rad_s))
