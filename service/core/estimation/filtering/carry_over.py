"""A change of the carrier plan or of the catalogue in operation: the filter goes on with what stays.

Attitude, drift, commanded rate, chain, rain and hidden states belong to the spacecraft and the site and are kept with
what they share with the carriers that stay. The law of this file: nothing is learned here; what the new plan does not
know begins as wide as it is.
"""

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.filtering.anchor.anchor_watch import calm_anchor
from service.core.estimation.filtering.causes.carrier_faults import CarrierWatch
from service.core.estimation.filtering.causes.common_change import Cusum
from service.core.estimation.filtering.filter_records import FilterState
from service.core.estimation.filtering.model.filter_model import (
    FIRST_COMMON,
    FREE_REFERENCE_DB2,
    CarrierModel,
    Gaussian,
    carrier_states,
    common_states,
    core_size,
    hidden_count,
)
from service.core.estimation.filtering.watches.command_watch import executed_commands
from service.core.estimation.filtering.watches.rate_watch import MovingState, RateWatch, inertial_motion


def carry_over(
    old: CarrierModel,
    new: CarrierModel,
    state: FilterState,
    position: IntArray,
    reference_db: FloatArray,
    reference_sigma_db: FloatArray,
    is_unknown: BoolArray,
) -> FilterState:
    """Return the state of a filter whose carrier plan has changed.

    Parameters
    ----------
    old, new : CarrierModel
        The N carriers before and the M carriers from now on.
    state : FilterState
        State under the old plan; it is not changed.
    position : ndarray, shape (M,)
        Number that each new carrier had in the old plan, -1 = it is new.
    reference_db : ndarray, shape (M,), dB
        What is added to the reference error of each: where a reference level was lowered by 0.2 dB all deviations of
        the carrier are 0.2 dB more from now on, and so is its reference error.
    reference_sigma_db : ndarray, shape (M,), dB
        One standard deviation of the references of new carriers; not used for those that stay.
    is_unknown : ndarray, shape (M,)
        Carriers whose level nobody knows: they are flagged and show it first.

    Returns
    -------
    FilterState
        Same epoch, attitude and covariance of it.

    Notes
    -----
    Coloured parts of a staying carrier go on where both plans have the same number of correlation times, and common
    parts likewise; else they begin at zero with stationary variance.
    """
    is_kept = (position >= 0) & ~is_unknown
    source = np.where(is_kept, position, -1)
    watch = _carried_watch(state.carriers, source, reference_db, reference_sigma_db, is_unknown)
    noise = state.noise._replace(
        white_scale=_picked(state.noise.white_scale, source, 1.0),
        running_mean=_picked(state.noise.running_mean, source, 0.0),
    )
    # the common value stands behind those of the carriers
    series = np.append(source, old.carriers)
    minute = state.minute._replace(
        total=_picked(state.minute.total, series, 0.0), rows=_picked(state.minute.rows, series, 0.0)
    )
    sigma_db = np.where(is_unknown, np.sqrt(FREE_REFERENCE_DB2), reference_sigma_db)
    return state._replace(
        gaussian=_carried_gaussian(old, new, state.gaussian, source, reference_db, sigma_db),
        carriers=watch,
        noise=noise,
        minute=minute,
        anchor=calm_anchor(new.carriers, state.anchor.since_us),
        model_variance_db2=_picked(state.model_variance_db2, source, 0.0),
        # sums over carriers that are gone mean nothing; what was found of the commands stands
        command=executed_commands()._replace(share=state.command.share, minutes_left=state.command.minutes_left),
    )


def without_rates(state: FilterState, watch: RateWatch) -> FilterState:
    """Return the state of a filter that goes on by the inertial model, whatever the watch on the rates says."""
    moving = MovingState(state.epoch_us, state.gaussian, state.drift, state.command)
    return state._replace(**inertial_motion(watch, moving)[1]._asdict())


def _picked(values: FloatArray, source: IntArray, fill: float) -> FloatArray:
    """Return the columns `source` of values (..., N), `fill` where it is -1."""
    return np.where(source >= 0, values[..., np.maximum(source, 0)], fill)


def _carried_watch(
    watch: CarrierWatch,
    source: IntArray,
    reference_db: FloatArray,
    reference_sigma_db: FloatArray,
    is_unknown: BoolArray,
) -> CarrierWatch:
    """Return the health of the carriers of the new plan; levels move with the references."""
    is_flagged = _picked(watch.is_flagged.astype(np.float64), source, 0.0) > 0.0
    return CarrierWatch(
        _picked(watch.skip_minutes, source, 0.0),
        is_flagged | is_unknown,
        _picked(watch.flagged_minutes, source, 0.0),
        # a carrier that nobody knows has no level to come back to
        np.where(is_unknown, np.nan, _picked(watch.saved_reference_db, source, 0.0) + reference_db),
        _picked(watch.saved_variance_db2, source, 0.0),
        _picked(watch.residuals_db, source, np.nan) + reference_db,
        Cusum(_picked(watch.cusum.up, source, 0.0), _picked(watch.cusum.down, source, 0.0)),
        _picked(watch.absent_minutes, source, 0.0),
        _picked(watch.is_relearned.astype(np.float64), source, 0.0) > 0.0,
        np.where(is_unknown, np.nan, _picked(watch.aligned_reference_db, source, 0.0) + reference_db),
        np.where(source >= 0, _picked(watch.aligned_variance_db2, source, 0.0), reference_sigma_db**2),
    )


def _carried_gaussian(
    old: CarrierModel,
    new: CarrierModel,
    gaussian: Gaussian,
    source: IntArray,
    reference_db: FloatArray,
    sigma_db: FloatArray,
) -> Gaussian:
    """Return the state vector of the new plan."""
    hidden = hidden_count(old, len(gaussian.mean))
    origin = _origins(old, new, source, hidden)
    fresh = np.concatenate(
        [
            np.zeros(FIRST_COMMON),
            new.common_sigma_db**2,
            np.zeros(hidden),
            (new.coloured_sigma_db.T**2).ravel(),
            np.asarray(sigma_db) ** 2,
        ]
    )
    is_kept = origin >= 0
    rows = np.maximum(origin, 0)
    both = is_kept[:, None] & is_kept[None, :]
    covariance = np.where(both, gaussian.covariance[np.ix_(rows, rows)], np.diag(np.where(is_kept, 0.0, fresh)))
    mean = np.where(is_kept, gaussian.mean[rows], 0.0)
    mean[-new.carriers :] += reference_db
    return Gaussian(mean, covariance)


def _origins(old: CarrierModel, new: CarrierModel, source: IntArray, hidden: int) -> IntArray:
    """Return where each state of the new plan (D,) stood in the old one, -1 = nowhere."""
    origin = np.full(core_size(new, hidden) + new.carriers * (new.components + 1), -1, dtype=np.int64)
    origin[:FIRST_COMMON] = np.arange(FIRST_COMMON)
    if core_size(old) == core_size(new):
        origin[common_states(new)] = np.arange(FIRST_COMMON, core_size(old))
    origin[core_size(new) : core_size(new, hidden)] = np.arange(core_size(old), core_size(old, hidden))
    staying = np.flatnonzero(source >= 0)
    there, here = carrier_states(old, source[staying], hidden), carrier_states(new, staying, hidden)
    origin[here[-1]] = there[-1]
    if old.components == new.components:
        origin[here[:-1]] = there[:-1]
    return origin
