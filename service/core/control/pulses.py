"""Torque pulses: a mean torque far below the drive's quantum, made of rare pulses that end by themselves.

A loop in tracking wants 1e-6 N m, a wheel moves in steps of 2e-3 N m. The wanted impulse is carried from period to
period until it fills the shortest pulse; what a pulse cannot express stays in the carry, so that the mean torque over
many periods equals the wanted one (first-order sigma-delta modulation).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


class PulseTrain(NamedTuple):
    """One pulse an axis and what stays for the next period."""

    #: (3,) N m, 0 = no pulse on this axis
    torque_n_m: FloatArray
    #: (3,) s
    duration_s: FloatArray
    #: (3,) N m s, torque times duration
    impulse_n_m_s: FloatArray
    #: (3,) N m s, wanted but not yet given
    carry_n_m_s: FloatArray
    #: (3,) whether the torque limit cut the wanted impulse
    is_saturated: BoolArray


def shape_pulses(
    torque_n_m: FloatArray,
    carry_n_m_s: FloatArray,
    *,
    period_s: float,
    limit_n_m: float,
    quantum_n_m: float,
    min_pulse_s: float,
    time_step_s: float,
) -> PulseTrain:
    """Return the pulses that give a mean torque over one command period.

    Parameters
    ----------
    torque_n_m : ndarray, shape (3,), N m
        Wanted mean torque on each axis.
    carry_n_m_s : ndarray, shape (3,), N m s
        Impulse left over from earlier periods.
    period_s : float, s
        Command period; every pulse ends inside it.
    limit_n_m : float, N m
        Greatest torque on an axis.
    quantum_n_m : float, N m
        Smallest step of the drive; pulse torques are whole multiples of it.
    min_pulse_s, time_step_s : float, s
        Shortest pulse and the grid of durations.

    Returns
    -------
    PulseTrain
        The impulse given plus the new carry equals the wanted impulse plus the old carry wherever nothing saturated;
        where it did, the carry is zero: a saturated wish is not saved up (no wind-up). A limit below the quantum
        allows no pulse at all.
    """
    wanted = torque_n_m * period_s + carry_n_m_s
    steps_at_limit = np.floor(limit_n_m / quantum_n_m * (1.0 + 1e-12))
    longest_s = np.floor(period_s / time_step_s * (1.0 + 1e-12)) * time_step_s
    # a period shorter than the grid of durations has room for no pulse; its wish is carried on
    steps = np.ceil(np.abs(wanted) / (quantum_n_m * max(longest_s, time_step_s)))
    is_saturated = steps > steps_at_limit
    steps = np.clip(steps, 1.0, max(steps_at_limit, 1.0))
    ideal_s = np.minimum(np.abs(wanted) / (steps * quantum_n_m), longest_s)
    duration_s = np.floor(ideal_s / time_step_s * (1.0 + 1e-12)) * time_step_s
    is_given = (duration_s >= min_pulse_s) & (steps <= steps_at_limit)
    duration_s = np.where(is_given, duration_s, 0.0)
    torque = np.where(is_given, np.sign(wanted) * steps * quantum_n_m, 0.0)
    impulse = torque * duration_s
    carry = np.where(is_saturated, 0.0, wanted - impulse)
    return PulseTrain(torque, duration_s, impulse, carry, is_saturated)
