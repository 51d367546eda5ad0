"""Succession function of one-sided motion: speed at an arrival at the first line to speed at the next.

Friction of the rotor turns the body to one side all the time; pulses throw it back. Equations (23) and (24) of the
paper with the displacement during a pulse complete, ``theta' tau + eps tau^2 / 2``: of the printed one the first term
is missing. The function is smooth where the number of pulses stays the same and jumps where it changes.

Friction keeps the sign that the momentum has at rest; `limit_cycle` says where a cycle leaves that ground.
"""

import numpy as np

from service.core.flexible.phi_functions import FloatArray
from service.core.flexible.return_kernels import Follow, OneSided, follow
from service.core.flexible.spacecraft import WheelDrive, accelerations
from service.core.flexible.switching_law import SwitchingLaw, require_law


def one_sided_motion(drive: WheelDrive, law: SwitchingLaw) -> OneSided:
    """Return the numbers of one-sided motion.

    Raises
    ------
    ValueError
        An external torque, no friction, or a relay: none of them has a one-sided cycle of pulses.
    """
    require_law(law)
    passive, pulse, viscous = accelerations(drive)
    if drive.external_torque_n_m != 0.0:
        raise ValueError(
            f"external_torque_n_m is {drive.external_torque_n_m:g}: momentum drifts to its limit and no cycle closes; "
            "set it to 0 here and follow the motion itself instead"
        )
    if passive == 0.0:
        raise ValueError(
            "neither dry nor viscous friction: nothing brings the body back to its line; raise one of them"
        )
    if law.is_relay:
        raise ValueError("pulse_s is infinite: a relay has no cycle of pulses; give the length of a pulse")
    lines = (law.alpha_rad, law.beta_rad, law.pulse_s, law.pulse_count, law.line_step_rad)
    return OneSided(passive, pulse, viscous, *lines)


def succession(speeds_rad_s: FloatArray, motion: OneSided) -> FloatArray:
    """Return the speeds (S,) of the next arrivals after arrivals at some speeds (S,); NaN where there is none."""
    return follow(np.asarray(speeds_rad_s, dtype=np.float64), 1, motion)[:, 1]


def koenigs_lamerey(speed_rad_s: float, returns: int, motion: OneSided, follower: Follow = follow) -> FloatArray:
    """Return the ladder (2 R + 1, 2) of Koenigs and Lamerey from one arrival: corners (w_k, w_k), (w_k, w_k+1).

    Parameters
    ----------
    speed_rad_s : float, rad/s
        First arrival.
    returns : int
        R; the ladder is shorter where the motion does not return.
    motion : OneSided
        Its numbers.
    follower : callable
        `follow` or its compiled form.
    """
    speeds = follower(np.array([speed_rad_s]), returns, motion)[0]
    speeds = speeds[np.isfinite(speeds)]
    corners = np.repeat(speeds, 2)
    return np.column_stack([corners[:-1], corners[1:]])[: 2 * len(speeds) - 1]
