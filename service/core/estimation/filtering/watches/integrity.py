"""Integrity: may control use this attitude, and if not, why.

The law of this file: every condition that fails is named; nothing is latched, each reason stands as long as its cause.
"""

import math
from typing import NamedTuple

from service.core.estimation.filtering.model.filter_model import FloatArray

#: unknowns of a row beside the carriers' own: three angles and the common level
_UNKNOWNS = 4


class IntegrityLimits(NamedTuple):
    """Limits within which control may use the attitude."""

    #: three sigma of yaw stay within the 0.3 deg that make a torque wrong; quiet carriers leave 0.09-0.12, flicker
    #: 0.11-0.13
    sigma_yaw_deg: float = 0.10
    sigma_roll_deg: float = 0.06
    sigma_pitch_deg: float = 0.10
    #: greatest protection level of roll and of pitch, deg
    alert_deg: float = 0.22
    redundancy: int = 2
    #: largest running mean of normalised innovation squared a degree of freedom
    nis_ratio: float = 2.0
    #: share of references learned again above which a new alignment is advised
    relearned_share: float = 1.0 / 3.0


class IntegrityInputs(NamedTuple):
    """Inputs of the integrity decision."""

    #: (3,) deg
    sigma_deg: FloatArray
    #: (3,) protection levels, deg, NaN = not known
    protection_deg: FloatArray
    carriers_used: int
    is_raining: bool
    is_chain_held: bool
    nis_ratio: float
    #: (3,) whether motion that nobody announced is suspected
    is_unannounced: tuple[bool, bool, bool]
    relearned: int
    carriers: int
    #: whether commands are suspected not to act as announced
    is_command_doubted: bool = False


class Integrity(NamedTuple):
    """Verdict on a row."""

    is_control_allowed: bool
    #: (yaw, roll, pitch)
    is_axis_allowed: tuple[bool, bool, bool]
    #: why not, in a fixed order
    reasons: tuple[str, ...]
    is_realignment_advised: bool


def assess(evidence: IntegrityInputs, limits: IntegrityLimits) -> Integrity:
    """Return whether control may use an attitude.

    Parameters
    ----------
    evidence : IntegrityInputs
        Of the row.
    limits : IntegrityLimits
        Settings.

    Returns
    -------
    Integrity
        Control is allowed when no reason stands against roll and pitch; yaw alone may be withheld.

    Examples
    --------
    >>> import numpy as np
    >>> sigma, level = np.array([0.3, 0.01, 0.02]), np.array([1.2, 0.09, 0.12])
    >>> calm = IntegrityInputs(sigma, level, 16, False, False, 1.0, (False, False, False), 0, 16)
    >>> assess(calm, IntegrityLimits()).is_axis_allowed
    (False, True, True)
    """
    yaw, roll, pitch = evidence.sigma_deg.tolist()
    _, *levels_deg = evidence.protection_deg.tolist()
    level_deg, is_monitored = max(levels_deg), all(map(math.isfinite, levels_deg))
    checks = (
        ("downlink_fade", evidence.is_raining),
        ("chain_step", evidence.is_chain_held),
        ("sigma_roll", not roll < limits.sigma_roll_deg),
        ("sigma_pitch", not pitch < limits.sigma_pitch_deg),
        ("integrity_unmonitored", not is_monitored),
        ("protection_level", is_monitored and level_deg > limits.alert_deg),
        ("redundancy", evidence.carriers_used - _UNKNOWNS < limits.redundancy),
        ("innovations", evidence.nis_ratio > limits.nis_ratio),
        # a command that is not carried out as announced is a motion that nobody announced
        ("unannounced_motion", any(evidence.is_unannounced[1:]) or evidence.is_command_doubted),
    )
    reasons = tuple(name for name, fails in checks if fails)
    is_allowed = not reasons
    is_yaw_allowed = is_allowed and yaw < limits.sigma_yaw_deg and not evidence.is_unannounced[0]
    return Integrity(
        is_allowed,
        (is_yaw_allowed, is_allowed, is_allowed),
        reasons,
        evidence.relearned > limits.relearned_share * evidence.carriers,
    )
