"""One closed loop in the orbital frame, as a whole: what is refused before it flies, the flight, its figures of merit.

Angles and rates are in the axes of the package (z up, y along the orbit normal), named roll, pitch, yaw.
"""

import math
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from service.core.dynamics.orbital_frame_flight import (
    FlightRecord,
    FloatArray,
    Start,
    fly_spacecraft,
    harmonic_amplitude,
    mean_over_orbits,
    time_within,
)
from service.core.dynamics.orbital_frame_kernel import Fly, fly
from service.core.dynamics.orbital_frame_model import OrbitalFrameSpacecraft, Triple, refusals

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
