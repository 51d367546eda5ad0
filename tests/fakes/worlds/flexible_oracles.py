"""Closed forms of limits in which the motion of the flexible spacecraft is known exactly."""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.flexible.propagation import MotionLeg, brent_root, states_at
from service.core.flexible.return_kernels import OneSided
from service.core.flexible.spacecraft import HubMode


def frictionless_succession(speeds_rad_s: FloatArray, motion: OneSided) -> FloatArray:
    """Return the succession (S,) of a single pulse without viscous loss; NaN where the body turns before the line."""
    gained = motion.pulse_rad_s2 * motion.pulse_s
    fallen = 2.0 * motion.passive_rad_s2 * motion.pulse_s * (speeds_rad_s - 0.5 * gained)
    square = (speeds_rad_s - gained) ** 2 - fallen
    return np.sqrt(np.where(square >= 0.0, square, np.nan))


class StaggeredForms(NamedTuple):
    """Cycle of N pulses at N lines with instantaneous pulses."""

    #: (N,) at each line
    speeds_rad_s: FloatArray
    multiplier: float


def staggered_forms(motion: OneSided) -> StaggeredForms | None:
    """Return the cycle of all lines in the limit of instantaneous pulses without viscous loss; None: there is none.

    The sum of ``v_i - Delta / 2`` is zero, ``v_i+1^2 = (Delta - v_i)^2 + 2 eps_c (L_i+1 - L_i)``, and the multiplier is
    minus the product of ``(Delta - v_i) / v_i+1``, for an odd number of pulses; an even number has no fixed cycle.
    """
    gained = motion.pulse_rad_s2 * motion.pulse_s

    def balance(first: float) -> float:
        return float(np.sum(_staggered_speeds(first, motion)[:-1] - 0.5 * gained))

    if motion.pulse_count % 2 == 0 or balance(0.0) * balance(gained) > 0.0:
        return None
    speeds = _staggered_speeds(brent_root(balance, 0.0, gained), motion)
    if not speeds[1:].all():
        # the body turns before a line
        return None
    ratio = (gained - speeds[:-1]) / speeds[1:]
    return StaggeredForms(speeds[:-1], -float(np.prod(ratio)))


def _staggered_speeds(first: float, motion: OneSided) -> FloatArray:
    """Return the speeds at the lines and at the return to the first, (N + 1,)."""
    gained = motion.pulse_rad_s2 * motion.pulse_s
    climb = 2.0 * motion.passive_rad_s2 * motion.line_step_rad
    steps = [climb] * (motion.pulse_count - 1) + [-(motion.pulse_count - 1) * climb]
    speeds = [first]
    for step in steps:
        speeds.append(math.sqrt(max((gained - speeds[-1]) ** 2 + step, 0.0)))
    return np.array(speeds)


def bi_plane_invariant(leg: MotionLeg, mode: HubMode, elapsed_s: FloatArray) -> FloatArray:
    """Return K (T,) of equation (11) along a leg of constant torque (c = 0); it does not change.

    Parameters
    ----------
    leg : MotionLeg
        With ``decay_1_s`` zero.
    mode : HubMode
        That of the leg.
    elapsed_s : ndarray, shape (T,), s
        Times in order, closer together than half a period of the mode, the first zero.

    Notes
    -----
    ``[y + xi (x - x_c)]^2 + nu^2 (x - x_c)^2 = K exp(2 xi / nu arctg(...))`` with x = thU, y = thU' / w. The printed
    arctg holds for a quarter of a turn; here it is unwrapped.
    """
    states = states_at(leg, elapsed_s)
    nu = math.sqrt(1.0 - mode.damping_ratio**2)
    centre = leg.offset_rad + leg.decaying_rad
    x = nu * (states[:, 2] - centre)
    y = states[:, 3] / mode.omega_rad_s + mode.damping_ratio * (states[:, 2] - centre)
    turn_rad = np.unwrap(np.arctan2(y, x))
    return np.asarray((x * x + y * y) * np.exp(-2.0 * mode.damping_ratio / nu * turn_rad))
