"""Commanded corrections watched: whether the spacecraft does what the ground announced, or the opposite, or nothing.

    x(s) = x + (s - s0) v          nu(s) = nu - (s - s0) H v          s = share of the commands that is carried out
    log p(s) / p(s0) = (s - s0) b - (s - s0)^2 j / 2      b = sum (H v)' S^-1 nu      j = sum (H v)' S^-1 H v

v is the derivative of the state by s: commands enter it as they enter attitude and rate, updates take out what the
powers have told; a rate that was given long ago is no longer in question. A roll command against a yaw that nobody
announced looks like a command that was lost; a yaw rate of unknown size therefore runs beside s as a second column and
is taken out of b and j. Where another share explains the last hour beyond chance the state moves along v, the share is
believed for an hour and control is told. The law of this file: shares of a short list; sums forget, so that what was
commanded long ago excuses nothing.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray
from service.core.estimation.filtering.filter_update import Innovation
from service.core.estimation.filtering.model.filter_model import (
    ATTITUDE,
    RAIN,
    RATE,
    CarrierModel,
    FilterSettings,
    Gaussian,
    KnownMotion,
    common_states,
    core_size,
    no_motion,
)
from service.core.estimation.filtering.model.hidden_motion import hidden_transition
from service.core.estimation.filtering.model.step_inputs import motion_over

#: shares that an on-board mode makes of a command: other sign, nothing, half, all, twice
SHARES = (-1.0, 0.0, 0.5, 1.0, 2.0)
#: log likelihood ratio that is believed; ten worlds of two days whose commands are carried out stay below it
BELIEVED = 5.0
#: sums forget with this time, minutes
_FORGET_MINUTES = 60.0
#: a share found is known to this
_SHARE_SIGMA = 0.25
#: minutes for which a found share is told and believed
DOUBTED_MINUTES = 60.0
#: size of yaw rates that nobody announced, deg/h
_UNTOLD_YAW_DEG_H = 0.4
#: an attitude that commands moved by less than this is not watched, deg
_LEAST_DEG = 1e-4
#: a share that would move the attitude by more than this is not believed: its first order is not enough, deg
_MOST_DEG = 0.5


class CommandWatch(NamedTuple):
    """State of the test whether commands act as announced."""

    #: (D, 2) derivative of the state by the share and by an unannounced yaw rate, deg/h; empty before the first command
    sensitivity: FloatArray
    #: (2,) and (2, 2)
    score: FloatArray
    information: FloatArray
    #: estimated share of the commands that is executed
    share: float
    #: minutes for which control is still warned that commands are doubted
    minutes_left: float
    #: whether torques were commanded, not corrections of angles alone
    is_by_torque: bool = False

    @property
    def is_doubted(self) -> bool:
        """Return whether commands are suspected not to act as announced."""
        return self.minutes_left > 0.0


def executed_commands() -> CommandWatch:
    """Return the watch of a spacecraft that does what it is told."""
    return CommandWatch(np.empty((0, 2)), np.zeros(2), np.zeros((2, 2)), 1.0, 0.0)


def without_evidence(watch: CommandWatch) -> CommandWatch:
    """Return the watch after something else was found that may have moved what was seen."""
    return watch._replace(score=np.zeros(2), information=np.zeros((2, 2)))


def doubting_settings(settings: FilterSettings, watch: CommandWatch) -> FilterSettings:
    """Return the settings with the error that the effect of commands has while they are doubted."""
    return settings._replace(correction_scale=_SHARE_SIGMA, torque_scale=_SHARE_SIGMA) if watch.is_doubted else settings


def believed_motion(watch: CommandWatch, known: KnownMotion) -> KnownMotion:
    """Return the known motion with its corrections and torques scaled by the estimated share."""
    if watch.share == 1.0:
        return known
    correction_deg, rate_change_deg_h = watch.share * known.correction_deg, watch.share * known.rate_change_deg_h
    return known._replace(correction_deg=correction_deg, rate_change_deg_h=rate_change_deg_h)


def pass_commands(
    model: CarrierModel,
    settings: FilterSettings,
    watch: CommandWatch,
    step_us: int,
    known: KnownMotion,
    is_flagged: BoolArray,
    *,
    is_raining: bool,
    from_us: int = 0,
    hidden: int = 0,
) -> CommandWatch:
    """Return the watch after a step, before its measurement.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    settings : FilterSettings
        As configured or with the learned drift: only the transition counts.
    watch : CommandWatch
        Before.
    step_us : int, microseconds
        Length of the step, > 0.
    known : KnownMotion
        As announced.
    is_flagged : ndarray, shape (N,)
        Carriers that are out: their own states have no part in it.
    is_raining : bool
        Whether rain is kept.
    from_us : int, microseconds UTC
        Epoch at which the step begins.
    hidden : int
        Hidden states of the filter.
    """
    core = core_size(model, hidden)
    size = core + model.carriers * (model.components + 1)
    seconds = step_us / 1e6
    minutes = seconds / 60.0
    left = max(0.0, watch.minutes_left - minutes)
    is_commanded = known is not no_motion() and bool(known.correction_deg.any() or known.rate_change_deg_h.any())
    if not is_commanded and _is_quiet(watch, size):
        return watch
    is_by_torque = watch.is_by_torque or bool(known.rate_change_deg_h.any())
    watch = watch._replace(minutes_left=left, share=watch.share if left > 0.0 else 1.0, is_by_torque=is_by_torque)
    if len(watch.sensitivity) != size:
        watch = watch._replace(sensitivity=np.zeros((size, 2)))
        if not is_commanded:
            return watch
    keep = math.exp(-minutes / _FORGET_MINUTES)
    watch = watch._replace(score=keep * watch.score, information=keep * watch.information)
    if not is_commanded and not watch.sensitivity.any():
        return watch
    moved = watch.sensitivity.copy()
    moved[RATE] *= keep
    common = common_states(model)
    moved[:9] = motion_over(step_us, settings).transition @ moved[:9]
    if hidden:
        added = hidden_transition(hidden, from_us, step_us, settings, known)
        moved[:9] += added @ watch.sensitivity[common.stop : core]
    hours = seconds / 3600.0
    moved[ATTITUDE, 0] += known.correction_deg + 0.5 * hours * known.rate_change_deg_h
    moved[RATE, 0] += known.rate_change_deg_h
    moved[ATTITUDE.start, 1] += hours
    moved[RAIN] *= 1.0 if is_raining else math.exp(-seconds / settings.rain_dry_tau_s)
    moved[common] *= np.exp(-seconds / model.common_tau_s)[:, None]
    own = moved[core:].reshape(-1, model.carriers, 2)
    own[:-1] *= np.exp(-seconds / model.coloured_tau_s).T[:, :, None]
    own[:, is_flagged] = 0.0
    return watch._replace(sensitivity=moved)


def _is_quiet(watch: CommandWatch, size: int) -> bool:
    """Return whether a step without commands leaves the watch of a state of a size as it is."""
    sums = watch.sensitivity, watch.score, watch.information
    is_known = len(watch.sensitivity) == size and watch.share == 1.0 and watch.minutes_left == 0.0
    return is_known and not any(map(np.count_nonzero, sums))


def push_row(
    model: CarrierModel,
    watch: CommandWatch,
    used: Innovation,
    covariance: FloatArray,
    is_shared: bool,  # noqa: FBT001 numba knows no arguments by keyword alone
) -> CommandWatch:
    """Return the watch after an update.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    watch : CommandWatch
        After `pass_commands`.
    used : Innovation
        Of the carriers that the update used.
    covariance : ndarray, shape (D, D)
        Of the state after the update.
    is_shared : bool
        Whether something else moved all carriers: such a row says nothing about commands.

    Notes
    -----
    ``K h = P H' R^-1 h`` with P after the update, ``S^-1 h = R^-1 (h - H K h)``: no matrix is inverted here.
    """
    sensitivity = watch.sensitivity
    if not len(sensitivity) or float(np.abs(sensitivity[ATTITUDE, 0]).max()) < _LEAST_DEG:
        return watch
    expected_db = _seen(model, used, sensitivity)
    weighted = expected_db / used.white_db2.reshape(-1, 1)
    count, core = len(model.rain_share), used.core_jacobian.shape[1]
    own, spread = np.zeros((count, 2)), np.empty(sensitivity.shape)
    own[used.carriers] = weighted
    spread[:core] = used.core_jacobian.T @ weighted
    for first in range(core, len(spread), count):
        spread[first : first + count] = own
    removed = covariance @ spread
    left = sensitivity - removed
    if is_shared:
        return CommandWatch(left, watch.score, watch.information, watch.share, watch.minutes_left, watch.is_by_torque)
    whitened = (expected_db - _seen(model, used, removed)) / used.white_db2.reshape(-1, 1)
    score = watch.score + whitened.T @ used.innovation_db
    information = watch.information + whitened.T @ expected_db
    return CommandWatch(left, score, information, watch.share, watch.minutes_left, watch.is_by_torque)


def _seen(model: CarrierModel, used: Innovation, change: FloatArray) -> FloatArray:
    """Return the effect of changes (D, 2) of the state on the carriers used (n, 2), dB."""
    core = used.core_jacobian.shape[1]
    own = change[core:].reshape(-1, len(model.rain_share), 2).sum(axis=0)
    seen: FloatArray = used.core_jacobian @ change[:core] + own[used.carriers]
    return seen


def share_gain(watch: CommandWatch, share: float) -> float:
    """Return the log likelihood ratio of a share against the believed one."""
    excused = watch.information[0, 1] / (watch.information[1, 1] + _UNTOLD_YAW_DEG_H**-2)
    score = float(watch.score[0] - excused * watch.score[1])
    information = float(watch.information[0, 0] - excused * watch.information[0, 1])
    return (share - watch.share) * score - 0.5 * (share - watch.share) ** 2 * information


def share_gains(watch: CommandWatch) -> dict[float, float]:
    """Return the log likelihood ratio of each share against the believed one."""
    return {share: share_gain(watch, share) for share in SHARES}


def is_share_likelier(watch: CommandWatch) -> bool:
    """Return whether another share than the believed one explains the commands beyond chance."""
    greatest = 0.0
    for share in SHARES:
        greatest = max(greatest, share_gain(watch, share))
    return greatest > BELIEVED


def likelier_share(watch: CommandWatch) -> float | None:
    """Return the share that explains the commands beyond chance, None = the believed one does."""
    gains = share_gains(watch)
    best = max(SHARES, key=gains.__getitem__)
    return best if gains[best] > BELIEVED else None


def missed_log_ratio(watch: CommandWatch) -> float:
    """Return how much likelier "no effect" or "reversed" is than that commands are carried out, logarithm.

    Once one of both is believed the ratio with which it came to be believed stands, and what the rows since then say
    of whole commands is added; where another share is believed commands act, and nothing is missed.
    """
    gains = share_gains(watch)
    if watch.share == 1.0:
        return max(gains[0.0], gains[-1.0])
    return BELIEVED - gains[1.0] if watch.share <= 0.0 else 0.0


def share_log_ratio(mean: float, variance: float, prior_sigma: float) -> float:
    """Return how much likelier the powers make a command that did nothing or the reverse than one that was carried out.

    Parameters
    ----------
    mean, variance : float
        Of the share of the command that was carried out, as the filter has it after the powers; variance > 0.
    prior_sigma : float
        Before them, about 0.

    Examples
    --------
    >>> round(share_log_ratio(0.0, 0.02, 1.0), 1), round(share_log_ratio(1.0, 0.02, 1.0), 1)
    (24.5, -25.5)
    """

    def likelihood(share: float) -> float:
        return -0.5 * (share - mean) ** 2 / variance + 0.5 * (share / prior_sigma) ** 2

    return max(likelihood(0.0), likelihood(-1.0)) - likelihood(1.0)


def judge_commands(watch: CommandWatch, state: Gaussian) -> tuple[CommandWatch, Gaussian]:
    """Return watch and state; where another share is likelier beyond chance the state moves to where it leads."""
    share = likelier_share(watch)
    if share is None:
        return watch, state
    change = watch.sensitivity[:, 0]
    nothing = executed_commands()._replace(
        sensitivity=np.zeros_like(watch.sensitivity), is_by_torque=watch.is_by_torque
    )
    if abs(share - watch.share) * float(np.abs(change[ATTITUDE]).max()) > _MOST_DEG:
        return nothing._replace(share=watch.share, minutes_left=DOUBTED_MINUTES), state
    moved = state.mean + (share - watch.share) * change
    moved[RAIN] = max(0.0, moved[RAIN])
    covariance = state.covariance + _SHARE_SIGMA**2 * np.multiply.outer(change, change)
    return nothing._replace(share=share, minutes_left=DOUBTED_MINUTES), Gaussian(moved, covariance)
