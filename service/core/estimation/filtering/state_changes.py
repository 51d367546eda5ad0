"""Numbers that come to the state of a running filter, or leave it: shares of commands, torques, sensors, carriers.

Attitude, drift, commanded rate, chain, rain and hidden states belong to the spacecraft and the site and are kept with
what they share with the carriers that stay. Nothing is learned here; what a new plan does not know begins as wide as it
is. Whatever holds one number a state moves with the states.
"""

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.filtering.filter_model import (
    FIRST_COMMON,
    FREE_REFERENCE_DB2,
    CarrierModel,
    FilterSettings,
    Gaussian,
    carrier_states,
    common_states,
    core_size,
    hidden_count,
)
from service.core.estimation.filtering.filter_state import CARRIER, FilterState, initial_carriers, initial_rates
from service.core.estimation.filtering.plant import (
    TORQUES,
    has_torque,
    is_pushed,
    sensor_states,
    torque_covariance,
    torque_prior_deg_h2,
)
from service.core.estimation.filtering.polarimeter import polarimeter_covariance, with_learned_feeds
from service.core.estimation.filtering.rate_sensor import follow_model
from service.core.estimation.filtering.wheel_momentum import momentum_covariance, with_learned_momentum

#: one standard deviation of the share of a command that nobody has reported
SHARE_SIGMA = 1.0


def torque_states(model: CarrierModel, states: int, shares: int, sensors: int = 0) -> slice | None:
    """Return the places of the torque in a vector of a size, None where there are none.

    `sensors` as `sensor_states` counts them.
    """
    first = common_states(model).stop + shares
    return slice(first, first + TORQUES) if hidden_count(model, states) - sensors - shares >= TORQUES else None


def inserted(state: Gaussian, position: int, new_covariance: FloatArray) -> Gaussian:
    """Return the state with new numbers of a covariance (n, n) at a place, zero and correlated with nothing before."""
    added = len(new_covariance)
    size = len(state.mean) + added
    kept = np.concatenate([np.arange(position), np.arange(position + added, size)])
    mean, covariance = np.zeros(size), np.zeros((size, size))
    mean[kept] = state.mean
    covariance[np.ix_(kept, kept)] = state.covariance
    new = np.arange(position, position + added)
    covariance[np.ix_(new, new)] = new_covariance
    return Gaussian(mean, covariance)


def dropped(state: Gaussian, positions: slice) -> Gaussian:
    """Return the state without some numbers: what the others owe to them stays their uncertainty."""
    covariance = np.delete(np.delete(state.covariance, positions, axis=0), positions, axis=1)
    return Gaussian(np.delete(state.mean, positions), covariance)


def with_share(model: CarrierModel, state: FilterState, shares: int) -> FilterState:
    """Return the state with one share more, of which nothing is known, behind those it has."""
    position = core_size(model, shares)
    widened = state.with_gaussian(inserted(state.gaussian, position, np.array([[SHARE_SIGMA**2]])))
    return widened._replace(sensitivity=np.insert(state.sensitivity, position, 0.0, axis=0))


def without_shares(model: CarrierModel, state: FilterState, shares: int) -> FilterState:
    """Return the state without its shares."""
    positions = slice(core_size(model), core_size(model, shares))
    narrowed = state.with_gaussian(dropped(state.gaussian, positions))
    return narrowed._replace(sensitivity=np.delete(state.sensitivity, positions, axis=0))


def with_torque(model: CarrierModel, gaussian: Gaussian, settings: FilterSettings) -> Gaussian:
    """Return the state at an alignment, which has no hidden states, with those of the torque that is stated, if any."""
    return _begun(gaussian, core_size(model), settings)


def with_stated_torque(
    model: CarrierModel, state: FilterState, shares: int, before: FilterSettings, after: FilterSettings
) -> FilterState:
    """Return the state after the catalogue states another torque that is not fed forward.

    Where it states one for the first time its states come, where it states none they go; a greater one is known less.
    What was learned under another profile is learned again: its shares and its wave are not those of the new one.
    """
    gaussian = state.gaussian
    positions = torque_states(model, len(state.mean), shares, sensor_states(before))
    if sensors_of(before) != sensors_of(after):
        # other wheels or polarimeters: they and torques begin again
        first = core_size(model, shares)
        known = (TORQUES if has_torque(before) else 0) + sensor_states(before)
        gaussian = _begun(dropped(gaussian, slice(first, first + known)), first, after)
        return without_evidence(state.with_gaussian(gaussian))
    if positions is not None and (before.fed_forward != after.fed_forward or not is_pushed(after)):
        gaussian, positions = dropped(gaussian, positions), None
    if positions is not None:
        grown = torque_prior_deg_h2(after) ** 2 - torque_prior_deg_h2(before) ** 2
        covariance, at = gaussian.covariance.copy(), np.arange(positions.start, positions.stop)
        covariance[at, at] += np.maximum(0.0, grown)
        gaussian = Gaussian(gaussian.mean, covariance)
    elif is_pushed(after):
        gaussian = inserted(gaussian, core_size(model, shares), torque_covariance(after))
    return without_evidence(state.with_gaussian(gaussian))


def without_evidence(state: FilterState) -> FilterState:
    """Return the state whose evidence on commands begins again; a share that is believed stays believed."""
    cleared = state.with_watch(score=0.0, information=0.0, is_by_torque=False)
    return cleared._replace(sensitivity=np.zeros((len(state.mean), 2)))


def sensors_of(settings: FilterSettings) -> tuple[object, ...]:
    """Return what the states of sensors begin with; a filter that runs knows more than new quiet days tell."""
    wheels = settings.momentum
    if wheels is not None and wheels.learned is not None:
        wheels = wheels._replace(learned=None, unknown_torque_deg_h2=None)
    return wheels, tuple(each._replace(learned=None) for each in settings.polarimeters)


def _begun(gaussian: Gaussian, position: int, settings: FilterSettings) -> Gaussian:
    """Return the state with the states of torque, wheels and polarimeters at a place, where there are any."""
    if settings.polarimeters:
        gaussian = inserted(gaussian, position, polarimeter_covariance(settings))
        gaussian = with_learned_feeds(gaussian, position, settings)
    if settings.momentum is not None:
        gaussian = inserted(gaussian, position, momentum_covariance(settings, settings.momentum))
    if not has_torque(settings):
        return gaussian
    gaussian = inserted(gaussian, position, torque_covariance(settings))
    return with_learned_momentum(gaussian, position + TORQUES, settings)


def without_rates(state: FilterState) -> FilterState:
    """Return the state of a filter that goes on by the inertial model and has judged no rate of the body."""
    moved = FilterState._make(each.copy() for each in state)
    follow_model(moved)
    return moved._replace(rates=initial_rates())


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
    parts likewise; else they begin at zero with stationary variance. Sums over carriers that are gone mean nothing;
    what was found of the commands stands.
    """
    source = np.where((position >= 0) & ~is_unknown, position, -1)
    is_kept, since_us = source >= 0, int(state.watch["since_us"][0])
    carriers = initial_carriers(np.asarray(reference_sigma_db, dtype=np.float64) ** 2, since_us)
    kept = [name for name in CARRIER.names or () if name not in ("hypothesis", "probability", "hypothesis_since_us")]
    for name in kept:
        carriers[name][is_kept] = state.carriers[name][source[is_kept]]
    # levels move with the references; a carrier that nobody knows has no level to come back to
    carriers["is_flagged"] |= is_unknown
    for name in ("saved_reference_db", "aligned_reference_db"):
        carriers[name] = np.where(is_unknown, np.nan, carriers[name] + reference_db)
    aside_db = np.where(is_kept, state.aside_db[:, np.maximum(source, 0)], np.nan) + reference_db
    anchor = np.full((*state.anchor.shape[:2], len(position)), np.nan)
    sigma_db = np.where(is_unknown, np.sqrt(FREE_REFERENCE_DB2), reference_sigma_db)
    gaussian = _carried_gaussian(old, new, state.gaussian, source, reference_db, sigma_db)
    carried = FilterState(
        *gaussian, carriers, state.watch, aside_db, anchor, state.sensitivity, state.sensors, state.rates
    )
    calm = {"anchor_minutes": 0, "answered_us": since_us}
    unknown = dict.fromkeys(("level_deg", "nominal_deg", "answer_sigma_deg"), np.nan)
    return without_evidence(carried.with_watch(**calm, **unknown))


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
