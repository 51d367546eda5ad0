"""Response of a flexible mode to a torque schedule, exact, edge by edge.

A step of torque moves the mode's centre by ``x = kn dM / (I w^2)`` and leaves the hub where it is: with
``thU = u_c + Re Z`` (rad) an edge is ``u_c += x``, ``Z -= x (1 - i xi / nu)``, and between edges
``Z *= exp((-xi w + i w nu) dt)``. Z outlives the schedule: it is what the next one begins with.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.flexible.phi_functions import FloatArray
from service.core.flexible.spacecraft import HubMode, require_finite, require_not_negative, require_positive

ComplexArray = NDArray[np.complex128]


class TorquePulse(NamedTuple):
    """One pulse of a schedule, on the body, in the clock of the schedule."""

    start_s: float
    duration_s: float
    torque_n_m: float

    @property
    def stop_s(self) -> float:
        """Return its end."""
        return self.start_s + self.duration_s


class ModeResponse(NamedTuple):
    """Response of one mode to a schedule, at one or more frequencies; all hub angles."""

    #: (F,) rad/s
    omega_rad_s: FloatArray
    #: (F,) rad, greatest deflection from time zero on, also after the last edge
    peak_rad: FloatArray
    #: (F,) rad, amplitude of the oscillation after the last edge
    residual_rad: FloatArray
    #: (F,) rad, greatest amplitude about the mode's centre, carried and after every edge
    swing_rad: FloatArray
    #: (F,) rad, Z at the last edge
    phasor_rad: ComplexArray
    #: s, the last edge, 0 without pulses
    end_s: float


def ordered_schedule(pulses: tuple[TorquePulse, ...]) -> tuple[TorquePulse, ...]:
    """Return the pulses by start.

    Raises
    ------
    ValueError
        A pulse without length, before time zero, not finite, or over another one.
    """
    for number, pulse in enumerate(pulses):
        require_not_negative(f"pulses[{number}].start_s", pulse.start_s)
        require_positive(f"pulses[{number}].duration_s", pulse.duration_s)
        require_finite(f"pulses[{number}].torque_n_m", pulse.torque_n_m)
    ordered = tuple(sorted(pulses))
    for former, latter in pairwise(ordered):
        # ends are sums of two decimals: a hair of overlap is rounding
        if latter.start_s < former.stop_s - 1e-9 * max(1.0, former.stop_s):
            raise ValueError(
                f"the pulse at {latter.start_s:g} s begins before the one at {former.start_s:g} s has ended "
                f"({former.stop_s:g} s): the wheel gives one torque at a time; move it or send their sum"
            )
    return ordered


def schedule_response(
    pulses: tuple[TorquePulse, ...],
    mode: HubMode,
    inertia_kg_m2: float,
    *,
    carried_rad: complex = 0j,
    omega_rad_s: FloatArray | None = None,
) -> ModeResponse:
    """Return the response of a mode to a schedule.

    Parameters
    ----------
    pulses : tuple of TorquePulse
        In order and apart (`ordered_schedule`).
    mode : HubMode
        w, xi, kn.
    inertia_kg_m2 : float, kg m^2
        Inertia of the axis.
    carried_rad : complex, rad
        Z at time zero, left by earlier schedules.
    omega_rad_s : ndarray, shape (F,), rad/s, or None
        Frequencies to try in place of the mode's own.

    Notes
    -----
    A single pulse of tau leaves ``2 x |sin(w tau / 2)|`` without damping; N of them every T leave
    ``|1 - q^N| / |1 - q|`` times that of one, ``q = exp((-xi w + i w nu) T)``.

    Examples
    --------
    >>> response = schedule_response((TorquePulse(0.0, 1.0, 0.2),), HubMode(0.6, 0.003, 0.4), 5000.0)
    >>> f"{response.peak_rad[0]:.6e}"
    '2.614520e-05'
    """
    omega = np.array([mode.omega_rad_s]) if omega_rad_s is None else omega_rad_s
    exponent: ComplexArray = np.asarray(omega * complex(-mode.damping_ratio, _nu(mode)), dtype=np.complex128)
    step = mode.coupling / (inertia_kg_m2 * omega**2)
    kick = step * complex(1.0, -mode.damping_ratio / _nu(mode))
    phasor = np.full(len(omega), carried_rad, dtype=np.complex128)
    edges_s, changes_n_m = np.array([(0.0, 0.0), *_edges(pulses)]).T
    stretches_s = np.append(np.diff(edges_s), math.inf)[:, None]
    begun, ended = [phasor], list[ComplexArray]()
    for turn, change_n_m in zip(np.exp(exponent * stretches_s[:-1]), changes_n_m[1:], strict=True):
        ended.append(begun[-1] * turn)
        begun.append(ended[-1] - kick * change_n_m)
    # all stretches at once: one after another, 500 pulses on 16 modes take four times as long
    centres, phasors = np.cumsum(changes_n_m)[:, None] * step, np.array(begun)
    # what is left of the centre after equal steps up and down is rounding
    centres[-1] = 0.0
    peak = _turning_peaks(centres, phasors, exponent, stretches_s).max(axis=0)
    if ended:
        peak = np.maximum(peak, np.abs(centres[:-1] + np.array(ended).real).max(axis=0))
    swings = np.abs(phasors)
    return ModeResponse(omega, peak, swings[-1], swings.max(axis=0), phasors[-1], float(edges_s[-1]))


def carry_phasor(phasor_rad: complex, mode: HubMode, elapsed_s: float) -> complex:
    """Return Z after a free time: from the last edge of one schedule to time zero of the next."""
    turned = np.exp(mode.omega_rad_s * complex(-mode.damping_ratio, _nu(mode)) * elapsed_s)
    return complex(phasor_rad * turned)


def _nu(mode: HubMode) -> float:
    """Return sqrt(1 - xi^2)."""
    return math.sqrt(1.0 - mode.damping_ratio**2)


def _edges(pulses: tuple[TorquePulse, ...]) -> list[tuple[float, float]]:
    """Return times and steps of torque, in order of time."""
    edges = [(pulse.start_s, pulse.torque_n_m) for pulse in pulses]
    edges += [(pulse.stop_s, -pulse.torque_n_m) for pulse in pulses]
    return sorted(edges)


def _turning_peaks(
    centre: FloatArray, phasor: ComplexArray, exponent: ComplexArray, duration_s: FloatArray
) -> FloatArray:
    """Return the greatest deflections (K, F) of K stretches without edges at their begin and their first two turns."""
    frequency = exponent.imag
    first_s = np.mod(0.5 * np.pi - np.angle(exponent * phasor), np.pi) / frequency
    peak = np.abs(centre + phasor.real)
    for turn_s in (first_s, first_s + np.pi / frequency):
        reached = centre + (phasor * np.exp(exponent * np.minimum(turn_s, duration_s))).real
        peak = np.maximum(peak, np.abs(reached))
    return peak
