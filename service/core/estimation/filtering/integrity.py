"""Integrity: may control use this attitude, and if not, why.

Two kinds of reasons. An estimate that may be *wrong in kind* is not used. One that is *less certain* than usual is, as
soon as something is lost by waiting: a linear loop steers best by its estimate, however uncertain, and to do nothing
leaves the spacecraft to the torque that acts. Nothing is lost while no torque turns it far within two hours and no
angle surely is far.

Every condition that inhibits is named. One that is judged by a figure stands for ten minutes at least, so that a figure
near its limit does not switch control on and off; every other one stands as long as its cause. (Until the figure is
within 0.8 of its limit would take the share of dry time with control from 0.97 to 0.87 in `weather_far` and from 0.89
to 0.57 in `weather_wet_season`.) The functions that judge are compiled.
"""

import math

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray
from service.core.estimation.filtering.filter_model import RATE
from service.core.estimation.filtering.filter_state import FIGURES, FilterState
from service.core.estimation.filtering.motion import write_motion, write_torques
from service.core.estimation.filtering.plant import TORQUES, FilterModel
from service.core.estimation.filtering.prediction import hidden_states

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
#: the period of the control law, for which the spacecraft may be left alone
_ALONE_US = 7200 * 10**6
#: how much worse than its mean a torque is taken, and how sure an angle must be, in sigmas: two of an angle would bring
#: `flicker_hard` 9 min of wrong torque for 4, three `transponder` 1 min for none
_TORQUE_SIGMAS, _ANGLE_SIGMAS = 2.0, 4.0
#: places of the figures that are held against limits
_ROLL, _PITCH, _LEVEL, _DOUBT, _INNOVATIONS, _YAW, _WAITING, _WAITING_YAW = range(FIGURES)
#: reasons in their order; a bit each
REASONS = (
    "downlink_fade",
    "chain_step",
    "integrity_unmonitored",
    "protection_level",
    "redundancy",
    "innovations",
    "unannounced_motion",
    "sigma_roll",
    "sigma_pitch",
)
_FADE, _CHAIN_STEP, _UNMONITORED, _PROTECTION, _REDUNDANCY, _NIS, _MOTION, _SIGMA_ROLL, _SIGMA_PITCH = (
    1 << place for place in range(len(REASONS))
)
#: so long an answer of the anchor holds, us, and its levels grow with sigma by this factor until the next one
_VALID_US, _LEVEL_SIGMAS = 1_800_000_000, 4.0


def assess(model: FilterModel, state: FilterState, carriers_used: int, found: NDArray[np.void]) -> None:
    """Write to a record of `RESULT` whether control may use the attitude of a state, and why not.

    Until when figures inhibit is written into the watch of the state.
    """
    watch = state.watch[0]
    sigma_deg = np.sqrt(np.diag(state.covariance)[:3])
    protection_deg, nominal_deg = np.full(3, np.nan), np.full(3, np.nan)
    if watch["epoch_us"] - watch["answered_us"] <= _VALID_US:
        for axis in range(3):
            grown_deg = _LEVEL_SIGMAS * max(sigma_deg[axis] - watch["answer_sigma_deg"][axis], 0.0)
            protection_deg[axis] = watch["level_deg"][axis] + grown_deg
            nominal_deg[axis] = watch["nominal_deg"][axis] + grown_deg
    loss_deg = waiting_loss_deg(model, state.mean, state.covariance, watch["epoch_us"])
    shares = figure_shares(model, sigma_deg, protection_deg, nominal_deg, watch["nis_ratio"], loss_deg)
    stands = np.zeros(FIGURES, dtype=np.bool_)
    for place in range(FIGURES):
        # negated, so that what is not known is beyond
        is_beyond = not shares[place] <= 1.0
        is_held = watch["beyond_until_us"][place] > watch["epoch_us"]
        if is_beyond and not is_held:
            watch["beyond_until_us"][place] = watch["epoch_us"] + _LEAST_US
        stands[place] = is_beyond or is_held
    is_moving = watch["reported_minutes"] > 0.0
    reasons = 0
    reasons |= _FADE if watch["is_raining"] else 0
    reasons |= _CHAIN_STEP if watch["hold_minutes"] > 0.0 else 0
    is_monitored = math.isfinite(protection_deg[1]) and math.isfinite(protection_deg[2])
    reasons |= 0 if is_monitored else _UNMONITORED
    reasons |= _PROTECTION if is_monitored and stands[_DOUBT] else 0
    reasons |= _REDUNDANCY if carriers_used - _UNKNOWNS < model.plant[0]["redundancy"] else 0
    reasons |= _NIS if stands[_INNOVATIONS] else 0
    # a command that is not carried out as announced is a motion that nobody announced
    reasons |= _MOTION if watch["doubted_minutes"] > 0.0 or watch["jump_minutes"] > 0.0 else 0
    if not stands[_WAITING]:
        # what is less certain than usual
        reasons |= _SIGMA_ROLL if stands[_ROLL] else 0
        reasons |= _SIGMA_PITCH if stands[_PITCH] else 0
        reasons |= _PROTECTION if is_monitored and stands[_LEVEL] else 0
        reasons |= _MOTION if is_moving[1] or is_moving[2] else 0
    is_yaw_allowed = reasons == 0 and (stands[_WAITING_YAW] or not (stands[_YAW] or is_moving[0]))
    relearned = np.count_nonzero(state.carriers["is_relearned"])
    is_advised = relearned > model.plant[0]["relearned_share"] * len(state.carriers)
    found["sigma_deg"][:], found["protection_deg"][:], found["nominal_deg"][:] = sigma_deg, protection_deg, nominal_deg
    found["waiting_loss_deg"][:], found["reasons"] = loss_deg, reasons
    found["is_yaw_allowed"], found["is_realignment_advised"] = is_yaw_allowed, is_advised


def figure_shares(
    model: FilterModel,
    sigma_deg: FloatArray,
    protection_deg: FloatArray,
    nominal_deg: FloatArray,
    nis_ratio: float,
    loss_deg: FloatArray,
) -> FloatArray:
    """Return each figure as a share of its limit (F,); levels that are not known are a reason of their own."""
    limits, shares = model.plant[0], np.zeros(FIGURES)
    shares[_ROLL], shares[_PITCH] = sigma_deg[1] / limits["sigma_roll_deg"], sigma_deg[2] / limits["sigma_pitch_deg"]
    shares[_YAW], shares[_INNOVATIONS] = sigma_deg[0] / limits["sigma_yaw_deg"], nis_ratio / limits["nis_ratio"]
    for axis in (1, 2):
        level_deg = 0.0 if math.isnan(protection_deg[axis]) else protection_deg[axis]
        usual_deg = 0.0 if math.isnan(nominal_deg[axis]) else nominal_deg[axis]
        shares[_LEVEL] = max(shares[_LEVEL], level_deg / limits["alert_deg"])
        shares[_DOUBT] = max(shares[_DOUBT], level_deg / max(limits["alert_deg"], DOUBT_RATIO * usual_deg))
    shares[_WAITING] = max(loss_deg[1], loss_deg[2]) / WAITING_LOSS_DEG
    shares[_WAITING_YAW] = loss_deg[0] / _YAW_LOSS_DEG
    return shares


def waiting_loss_deg(model: FilterModel, mean: FloatArray, covariance: FloatArray, epoch_us: int) -> FloatArray:
    """Return what is lost about yaw, roll and pitch (3,) in two hours without control, deg.

    The greater of two angles: by how much the torque may turn the axis, mean and two sigmas, and how far from zero the
    axis will surely be, mean less four sigmas. An angle that may as well be an error of the estimate is none of them:
    control would not remove it.
    """
    one, moving = model.plant[0], RATE.stop
    every, components = model.coloured_sigma_db.shape
    turns = np.zeros((9, moving + TORQUES))
    write_motion(turns, one["coupling_per_h"], one["drift_tau_h"], _ALONE_US / 3.6e9)
    places = np.arange(moving + TORQUES)
    count = moving
    hidden = hidden_states(model, len(mean))
    if one["is_pushed"] and hidden - one["sensor_states"] >= TORQUES:
        write_torques(turns, moving, epoch_us, _ALONE_US, one["coupling_per_h"], one["wave_period_us"])
        count += TORQUES
        places[moving:] += len(mean) - every * (components + 1) - one["sensor_states"] - TORQUES - moving
    loss_deg = np.zeros(3)
    for axis in range(3):
        if count > moving:
            turned, sigma = _combination(turns[axis], places, moving, count, mean, covariance)
            loss_deg[axis] = abs(turned) + _TORQUE_SIGMAS * sigma
        turned, sigma = _combination(turns[axis], places, 0, count, mean, covariance)
        loss_deg[axis] = max(loss_deg[axis], abs(turned) - _ANGLE_SIGMAS * sigma)
    return loss_deg


def _combination(
    turn: FloatArray, places: np.ndarray, first: int, stop: int, mean: FloatArray, covariance: FloatArray
) -> tuple[float, float]:
    """Return mean and sigma of a combination of some states."""
    total, variance = 0.0, 0.0
    for i in range(first, stop):
        total += turn[i] * mean[places[i]]
        for j in range(first, stop):
            variance += turn[i] * turn[j] * covariance[places[i], places[j]]
    return total, math.sqrt(max(variance, 0.0))
