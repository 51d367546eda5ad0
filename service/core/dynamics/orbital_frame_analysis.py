"""One closed loop in the orbital frame, as a whole: what is refused before it flies, the flight, its figures of merit.

Angles and rates are in the axes of the package (z up, y along the orbit normal), named roll, pitch, yaw.

Flights of the spacecraft in the orbital frame: start, seeded noise, record in degrees, figures of merit.
"""

import math
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.dynamics.orbital_frame_kernel import NO_YAW_ESTIMATE, Fly, fly
from service.core.dynamics.orbital_frame_model import OrbitalFrameSpacecraft, Triple, VerticalSensor, refusals
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


#: longest flight, s: ten orbits of the model
LONGEST_S = 60_000.0
#: Runge-Kutta steps of one flight: half a second compiled, and 90 MB of record and noise
MOST_STEPS = 500_000
#: without a compiler, 7 s
MOST_STEPS_PLAIN = 150_000


class BeyondOrbitalRate(StrEnum):
    """Behaviour where the measured roll rate exceeds the orbital rate, so that yaw does not follow from it."""

    #: the analysis is refused, or ends there
    REFUSE = "refuse"
    #: the law takes its second branch, half a right angle of either sign
    SECOND_BRANCH = "second_branch"
    #: the printed condition alone: the yaw torque fades, and from sqrt(2) on nu0 is imaginary and the flight ends
    AS_PRINTED = "as_printed"


class SettlingRequest(NamedTuple):
    """One flight and how it is looked at."""

    spacecraft: OrbitalFrameSpacecraft = OrbitalFrameSpacecraft()
    start: Start = Start()
    duration_s: float = 15_000.0
    seed: int = 1
    beyond: BeyondOrbitalRate = BeyondOrbitalRate.REFUSE
    #: until then the start is not forgotten
    settled_after_s: float = 1500.0
    #: deg, within which an axis counts as settled
    bound_deg: float = 0.1


class Merit(NamedTuple):
    """Figures of a flight; triples are roll, pitch, yaw, NaN where a flight is too short for a figure."""

    peak_deg: Triple
    #: after ``settled_after_s``
    settled_peak_deg: Triple
    settled_rms_deg: Triple
    #: from when on the angle stays within the bound, s; NaN: not at the end
    time_within_bound_s: Triple
    #: over the last two orbits, or the last one
    mean_yaw_deg: float
    #: amplitude at the orbital frequency over the last orbit
    harmonic_deg: Triple
    largest_torque_n_m: Triple
    #: of the periods after the first in which the torque is at its limit
    saturated_share: Triple
    largest_momentum_n_m_s: Triple
    #: measured roll rate over orbital rate
    largest_rate_ratio: float


class ClosedLoop(NamedTuple):
    """A flight with its figures."""

    flight: FlightRecord
    merit: Merit
    #: what to beware of, each ``(code, text)``
    warnings: tuple[tuple[str, str], ...]

    def thinned(self, points: int) -> "ClosedLoop":
        """Return the same with so many rows of the record at most: every k-th, the first among them."""
        every = max(1, math.ceil(len(self.flight.time_s) / points))
        columns = {name: column[::every].copy() for name, column in self.flight._asdict().items() if name != "end"}
        return self._replace(flight=self.flight._replace(**columns))


def check_closed_loop(request: SettlingRequest, most_steps: int = MOST_STEPS) -> None:
    """Raise ValueError, with the values at fault, for a flight that cannot be or would take too long."""
    spacecraft = request.spacecraft
    found = refusals(spacecraft)
    if not found and not 1.0 <= request.duration_s / spacecraft.computer.period_s <= most_steps / spacecraft.steps:
        longest_s = most_steps / spacecraft.steps * spacecraft.computer.period_s
        found.append(
            f"duration_s is {request.duration_s:g}: a flight lasts one period of the computer to {longest_s:g} s "
            f"({most_steps} steps)"
        )
    if request.duration_s > LONGEST_S:
        found.append(f"duration_s is {request.duration_s:g}: a flight lasts at most {LONGEST_S:g} s")
    if not found and request.start.rate_rad_s is not None:
        ratio = abs(request.start.rate_rad_s[0]) / spacecraft.law.orbital_rate_rad_s
        if ratio > _largest_ratio(request):
            found.append(_beyond_text("at the start", ratio, request.beyond))
    if found:
        raise ValueError("; ".join(found))


def fly_closed_loop(request: SettlingRequest, kernel: Fly = fly) -> ClosedLoop:
    """Return the flight of a settling request and its measures.

    Parameters
    ----------
    request : SettlingRequest
        Passed by ``check_closed_loop``.
    kernel : callable
        ``fly`` or its compiled form; they agree to rounding.

    Raises
    ------
    ValueError
        The roll rate exceeds the orbital rate on the way where the request does not say what the law does then.
    """
    # where beyond is refused, the guarded law flies on to where the record shows it
    is_guarded = request.beyond is not BeyondOrbitalRate.AS_PRINTED
    spacecraft = request.spacecraft._replace(law=request.spacecraft.law._replace(is_guarded=is_guarded))
    flight = fly_spacecraft(spacecraft, request.start, request.duration_s, request.seed, kernel)
    if not (np.isfinite(flight.yaw_deg).all() and np.isfinite(flight.momentum_n_m_s).all()):
        raise ValueError("the motion leaves all bounds: the loop is unstable, or its steps are too long")
    beyond = np.flatnonzero(np.abs(flight.rate_ratio) > 1.0)
    if len(beyond) and request.beyond is BeyondOrbitalRate.REFUSE:
        first = beyond[0]
        when = f"after {flight.time_s[first]:.3f} s"
        raise ValueError(_beyond_text(when, abs(float(flight.rate_ratio[first])), request.beyond))
    merit = _merit(flight, request)
    return ClosedLoop(flight, merit, _warnings(merit, spacecraft))


def _largest_ratio(request: SettlingRequest) -> float:
    """Return the largest roll rate over orbital rate from which a flight may start."""
    slope = abs(request.spacecraft.law.slope)
    printed = 1.0 / slope if slope > 0.0 else math.inf
    return {
        BeyondOrbitalRate.REFUSE: 1.0,
        BeyondOrbitalRate.SECOND_BRANCH: math.inf,
        BeyondOrbitalRate.AS_PRINTED: printed,
    }[request.beyond]


def _beyond_text(when: str, ratio: float, beyond: BeyondOrbitalRate) -> str:
    """Return the fault of a roll rate and its remedy."""
    why = "nu0 of the printed law is imaginary" if beyond is BeyondOrbitalRate.AS_PRINTED else "it tells no yaw"
    return (
        f"{when} the roll rate is {ratio:.3g} orbital rates and {why}: stop the roll first, "
        f"or ask for beyond_orbital_rate {BeyondOrbitalRate.SECOND_BRANCH.value}"
    )


def _merit(flight: FlightRecord, request: SettlingRequest) -> Merit:
    """Return the figures of a flight."""
    spacecraft, time_s = request.spacecraft, flight.time_s
    angles = np.column_stack([flight.roll_deg, flight.pitch_deg, flight.yaw_deg])
    late = angles[time_s > request.settled_after_s]
    limit_n_m = spacecraft.computer.torque_limit_n_m
    # what the computer asks for is a multiple of the quantum; wheels give a little less
    at_limit = np.abs(flight.torque_n_m[1:]) >= 0.99 * min(limit_n_m, _largest_multiple(spacecraft))
    orbit_s = 2.0 * math.pi / spacecraft.law.orbital_rate_rad_s
    orbits = min(2, int(time_s[-1] / orbit_s))
    last = time_s > time_s[-1] - orbit_s
    return Merit(
        peak_deg=_triple(np.abs(angles).max(axis=0)),
        settled_peak_deg=_triple(np.abs(late).max(axis=0) if len(late) else np.full(3, math.nan)),
        settled_rms_deg=_triple(np.sqrt((late**2).mean(axis=0)) if len(late) else np.full(3, math.nan)),
        time_within_bound_s=_triple(np.array([time_within(time_s, each, request.bound_deg) for each in angles.T])),
        mean_yaw_deg=mean_over_orbits(flight, spacecraft.law.orbital_rate_rad_s, orbits) if orbits else math.nan,
        harmonic_deg=_triple(
            np.array(
                [harmonic_amplitude(time_s[last], each[last], orbit_s) if orbits else math.nan for each in angles.T]
            )
        ),
        largest_torque_n_m=_triple(np.abs(flight.torque_n_m).max(axis=0)),
        saturated_share=_triple(at_limit.mean(axis=0)),
        largest_momentum_n_m_s=_triple(np.abs(flight.momentum_n_m_s).max(axis=0)),
        largest_rate_ratio=float(np.abs(flight.rate_ratio).max()),
    )


def _largest_multiple(spacecraft: OrbitalFrameSpacecraft) -> float:
    """Return the largest torque that the computer asks for, N m."""
    computer = spacecraft.computer
    if not computer.is_sampled:
        return computer.torque_limit_n_m
    quanta = math.floor(computer.torque_limit_n_m / computer.torque_quantum_n_m + 1e-9)
    return max(1, quanta) * computer.torque_quantum_n_m


def _warnings(merit: Merit, spacecraft: OrbitalFrameSpacecraft) -> tuple[tuple[str, str], ...]:
    """Return the warnings of a flight."""
    found = []
    shares = dict(zip(("roll", "pitch", "yaw"), merit.saturated_share, strict=True))
    full = [f"{axis} {share:.2%}" for axis, share in shares.items() if share > 0.0]
    if full:
        found.append(("torque.saturated", f"the torque is at its limit for a share of the flight: {', '.join(full)}"))
    if (
        spacecraft.wheels.is_real
        and max(merit.largest_momentum_n_m_s) >= 0.999 * spacecraft.wheels.momentum_limit_n_m_s
    ):
        found.append(("wheels.saturated", "a wheel reached its momentum limit and gave no torque from then on"))
    if math.isnan(merit.mean_yaw_deg):
        found.append(("flight.short", "shorter than an orbit: no mean yaw and no harmonics"))
    return tuple(found)


def _triple(values: FloatArray) -> Triple:
    """Return three plain numbers."""
    return (float(values[0]), float(values[1]), float(values[2]))
