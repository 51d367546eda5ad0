"""Repeater: stations that steer their power and transponders that hold theirs.

    automatic level control:  G = -10 lg (sum of what arrives / sum of what the plan says)   one G for all its carriers
    uplink power control:     u[k+1] = u[k] - (1 - exp(-dt / tau)) (change[k] + u[k]),   |u| <= limit

Both hide from the ground what they make up for: the first for the whole transponder at once, the second for its own
carrier alone.
"""

import numpy as np
from numpy.typing import NDArray

from analyzer_sim.streams import FloatArray
from analyzer_sim.world.payload.carriers import CarrierPlan
from analyzer_sim.world.scenario.story import RepeaterSettings


def power_control_db(change_db: FloatArray, row_period_s: float, tau_s: float, limit_db: float) -> FloatArray:
    """Return what a station adds (T,) against the change (T,) of its own carrier at the satellite.

    Examples
    --------
    >>> power_control_db(np.array([0.0, -2.0, -2.0]), 1e6, 1.0, 6.0).tolist()
    [0.0, 0.0, 2.0]
    """
    share = -float(np.expm1(-row_period_s / tau_s))
    added, value = [], 0.0
    for change in change_db.tolist():
        added.append(value)
        value = min(limit_db, max(-limit_db, value - share * (change + value)))
    return np.array(added)


def level_control_db(
    arriving_dbm: FloatArray, nominal_dbm: FloatArray, is_on: NDArray[np.bool_], members: list[int]
) -> FloatArray:
    """Return the gain (T,) by which a transponder holds its total power; levels (T, N) and (N,), dBm."""
    power_mw = np.where(is_on[:, members], 10.0 ** (arriving_dbm[:, members] / 10.0), 0.0)
    total_mw = np.sum(power_mw, axis=1)
    nominal_mw = float(np.sum(10.0 ** (nominal_dbm[members] / 10.0)))
    # with nothing on the air there is nothing to hold
    return np.where(total_mw > 0.0, -10.0 * np.log10(np.maximum(total_mw, 1e-30) / nominal_mw), 0.0)


def repeater_db(
    figures: RepeaterSettings,
    plan: CarrierPlan,
    arriving_dbm: FloatArray,
    is_on: NDArray[np.bool_],
    row_period_s: float,
) -> tuple[FloatArray, FloatArray]:
    """Return what power control adds at the stations and what level control adds in the repeater, (T, N) each, dB.

    `arriving_dbm` (T, N) is what reaches the transponders without either.
    """
    levels_dbm = np.array([carrier.level_dbm for carrier in plan.carriers])
    power, level = np.zeros_like(arriving_dbm), np.zeros_like(arriving_dbm)
    for name in figures.power_controlled:
        column = plan.column(name)
        change_db = arriving_dbm[:, column] - levels_dbm[column]
        limits = figures.power_control_tau_s, figures.power_control_limit_db
        power[:, column] = power_control_db(change_db, row_period_s, *limits)
    for transponder in figures.alc_transponders:
        members = [k for k, carrier in enumerate(plan.carriers) if carrier.transponder == transponder]
        level[:, members] = level_control_db(arriving_dbm + power, levels_dbm, is_on, members)[:, None]
    return power, level
