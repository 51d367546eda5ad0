"""Integrity: may control use this attitude, and if not, why.

Two kinds of reasons. An estimate that may be *wrong in kind* is not used. One that is *less certain* than usual is, as
soon as something is lost by waiting: a linear loop steers best by its estimate, however uncertain, and to do nothing
leaves the spacecraft to the torque that acts. Nothing is lost while no torque turns it far within two hours and no
angle surely is far.

The law of this file: every condition that inhibits is named. One that is judged by a figure stands for ten minutes at
least, so that a figure near its limit does not switch control on and off; every other one stands as long as its cause.
(Until the figure is within 0.8 of its limit would take the share of dry time with control from 0.97 to 0.87 in
`weather_far` and from 0.89 to 0.57 in `weather_wet_season`.)
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray, IntArray

#: unknowns of a row beside the carriers' own: three angles and the common level
_UNKNOWNS = 4
#: loss of roll or pitch by two hours without control from which an uncertain angle is steered by, deg
WAITING_LOSS_DEG = 0.1
#: the same of yaw, which is less certain for hours: from 0.1 deg on yaw left 0.97 deg where it now leaves 0.53
_YAW_LOSS_DEG = 0.05
#: how many times the nominal protection level the level must be to say that the angle may be wrong in kind
DOUBT_RATIO = 1.5
#: for how long a figure that passed its limit inhibits at least
_LEAST_US = 600 * 10**6
#: figures that are held against limits
_FIGURES = ("roll", "pitch", "level", "doubt", "innovations", "yaw", "waiting", "waiting_yaw")


class IntegrityLimits(NamedTuple):
    """Limits within which control may use the attitude."""

    #: three sigma of yaw stay near the 0.3 deg that make a torque wrong; quiet carriers leave 0.09-0.12, flicker
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

    #: microseconds UTC
    epoch_us: int
    #: (3,) deg
    sigma_deg: FloatArray
    #: (3,) protection levels, deg, NaN = not known
    protection_deg: FloatArray
    #: (3,) those if nothing were wrong with any carrier
    nominal_deg: FloatArray
    #: (3,) loss by two hours without control, deg
    waiting_loss_deg: FloatArray
    carriers_used: int
    is_raining: bool
    is_chain_held: bool
    nis_ratio: float
    #: (3,) whether motion that nobody announced is suspected
    is_unannounced: tuple[bool, bool, bool]
    relearned: int
    carriers: int
    #: whether commands are suspected not to act as announced, and whether all angles jumped, as no spacecraft does
    is_command_doubted: bool = False
    has_jumped: bool = False


class Integrity(NamedTuple):
    """Verdict on a row."""

    is_control_allowed: bool
    #: (yaw, roll, pitch)
    is_axis_allowed: tuple[bool, bool, bool]
    #: why not, in a fixed order
    reasons: tuple[str, ...]
    is_realignment_advised: bool


def good_figures() -> IntArray:
    """Return until when each figure inhibits at least (F,), microseconds UTC, of a filter that begins."""
    return np.zeros(len(_FIGURES), dtype=np.int64)


def assess(evidence: IntegrityInputs, limits: IntegrityLimits, beyond_until_us: IntArray) -> tuple[Integrity, IntArray]:
    """Return whether control may use an attitude, and until when its figures inhibit at least.

    Parameters
    ----------
    evidence : IntegrityInputs
        Of the row.
    limits : IntegrityLimits
        Settings.
    beyond_until_us : ndarray, shape (F,), microseconds UTC
        As the row before left them, or `good_figures`.

    Returns
    -------
    Integrity
        Control is allowed when no reason stands against roll and pitch; yaw alone may be withheld.
    ndarray, shape (F,), microseconds UTC
        For the next row.

    Examples
    --------
    >>> sigma, level, loss = np.array([0.3, 0.01, 0.02]), np.array([1.2, 0.09, 0.12]), np.array([0.05, 0.05, 0.05])
    >>> calm = IntegrityInputs(0, sigma, level, level, loss, 16, False, False, 1.0, (False, False, False), 0, 16)
    >>> assess(calm, IntegrityLimits(), good_figures())[0].is_axis_allowed
    (False, True, True)
    >>> assess(calm._replace(waiting_loss_deg=4.0 * loss), IntegrityLimits(), good_figures())[0].is_axis_allowed
    (True, True, True)
    """
    shares = _shares(evidence, limits)
    # negated, so that what is not known is beyond
    is_beyond = ~(shares <= 1.0)
    is_held = beyond_until_us > evidence.epoch_us
    until_us = np.where(is_beyond & ~is_held, evidence.epoch_us + _LEAST_US, beyond_until_us)
    if not np.array_equal(until_us, beyond_until_us):
        # else the same array: a state that did not change stays the one that compiled code holds
        beyond_until_us = until_us
    stands = dict(zip(_FIGURES, (is_beyond | is_held).tolist(), strict=True))
    reasons = _reasons(evidence, limits, stands)
    is_allowed = not reasons
    is_yaw_uncertain = stands["yaw"] or evidence.is_unannounced[0]
    integrity = Integrity(
        is_allowed,
        (is_allowed and (stands["waiting_yaw"] or not is_yaw_uncertain), is_allowed, is_allowed),
        reasons,
        evidence.relearned > limits.relearned_share * evidence.carriers,
    )
    return integrity, beyond_until_us


def _shares(evidence: IntegrityInputs, limits: IntegrityLimits) -> FloatArray:
    """Return each figure as a share of its limit (F,)."""
    yaw, roll, pitch = evidence.sigma_deg.tolist()
    _, *levels_deg = evidence.protection_deg.tolist()
    _, *nominal_deg = evidence.nominal_deg.tolist()
    yaw_loss_deg, *loss_deg = evidence.waiting_loss_deg.tolist()
    # levels that are not known are a reason of their own
    levels_deg = [0.0 if math.isnan(level) else level for level in levels_deg]
    doubted = (
        level / max(limits.alert_deg, DOUBT_RATIO * (0.0 if math.isnan(nominal) else nominal))
        for level, nominal in zip(levels_deg, nominal_deg, strict=True)
    )
    return np.array(
        [
            roll / limits.sigma_roll_deg,
            pitch / limits.sigma_pitch_deg,
            max(levels_deg) / limits.alert_deg,
            max(doubted),
            evidence.nis_ratio / limits.nis_ratio,
            yaw / limits.sigma_yaw_deg,
            max(loss_deg) / WAITING_LOSS_DEG,
            yaw_loss_deg / _YAW_LOSS_DEG,
        ]
    )


def _reasons(evidence: IntegrityInputs, limits: IntegrityLimits, stands: dict[str, bool]) -> tuple[str, ...]:
    """Return why roll and pitch may not be controlled, of the figures that stand beyond their limits."""
    is_monitored = bool(np.isfinite(evidence.protection_deg[1:]).all())
    wrong_in_kind = {
        "downlink_fade": evidence.is_raining,
        "chain_step": evidence.is_chain_held,
        "integrity_unmonitored": not is_monitored,
        "protection_level": is_monitored and stands["doubt"],
        "redundancy": evidence.carriers_used - _UNKNOWNS < limits.redundancy,
        "innovations": stands["innovations"],
        # a command that is not carried out as announced is a motion that nobody announced
        "unannounced_motion": evidence.is_command_doubted or evidence.has_jumped,
    }
    less_certain = {
        "sigma_roll": stands["roll"],
        "sigma_pitch": stands["pitch"],
        "protection_level": is_monitored and stands["level"],
        "unannounced_motion": any(evidence.is_unannounced[1:]),
    }
    found = [name for name, fails in wrong_in_kind.items() if fails]
    if not stands["waiting"]:
        found += [name for name, fails in less_certain.items() if fails and name not in found]
    return tuple(found)
