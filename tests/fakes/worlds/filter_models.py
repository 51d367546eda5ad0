"""Small carrier models for the tests of the attitude filter: every figure is chosen."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from filter_rows import step

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.effective_row import EffectiveRow, effective_row
from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    CarrierModel,
    FilterSettings,
    Gaussian,
    KnownMotion,
    carrier_states,
    initial_gaussian,
    no_motion,
)
from service.core.estimation.filtering.filter_state import FilterState, start
from service.core.estimation.filtering.plant import FilterModel, filter_model
from service.core.estimation.filtering.prediction import Innovation, innovate, update_state
from service.core.estimation.filtering.row_block import Declared, empty_result, empty_trace

MINUTE_US = 60_000_000


def carrier_model(carriers: int = 12, *, components: int = 2, common: int = 0, seed: int = 4, groups: int = 3):
    """Return a model of the payload's usual sizes."""
    rng = np.random.default_rng(seed)
    bend = rng.normal(0.0, 0.1, (carriers, 3, 3))
    hessian = 0.5 * (bend + bend.transpose(0, 2, 1)) + np.diag([0.0, -2.7, -1.5])
    shares = np.ones(carriers)
    shares[carriers - carriers // 4 :] = 0.1
    return CarrierModel(
        rng.normal(0.0, [0.16, 1.4, 1.2], (carriers, 3)),
        hessian,
        shares,
        np.arange(carriers, dtype=np.int64) % groups,
        np.full(carriers, 0.15),
        np.tile(np.array([0.07, 0.03, 0.02])[:components], (carriers, 1)),
        np.tile(np.array([1200.0, 7200.0, 36000.0])[:components], (carriers, 1)),
        np.full(carriers, 0.006),
        np.full(common, 0.05),
        np.full(common, 3600.0),
        np.tile(np.diag([0.02] * 3 + [0.1] * 6) ** 2, (carriers, 1, 1)),
    )


def aligned(model: CarrierModel, drift_deg_h=(0.04, 0.025, 0.025)) -> Gaussian:
    """Return the state at a good alignment at nominal attitude."""
    sigma = np.array([0.01, 0.005, 0.005])
    return initial_gaussian(model, np.zeros(3), sigma, np.full(model.carriers, 0.03), drift_deg_h=drift_deg_h)


def copied(state: FilterState) -> FilterState:
    """Return the state in arrays of its own, for functions that write into them."""
    return FilterState._make(each.copy() for each in state)


def bits(arrays: Iterable[np.ndarray]) -> list[bytes]:
    """Return the bytes of all numbers of a state or a result; what stands between fields of a record is none."""
    parts = [[each[name] for name in each.dtype.names] if each.dtype.names else [each] for each in arrays]
    return [part.tobytes() for each in parts for part in each]


def coasted(
    model: FilterModel,
    state: FilterState,
    step_us: int,
    known: KnownMotion | None = None,
    declared: Declared | None = None,
) -> FilterState:
    """Return the state after a step of time at whose end no carrier is measured."""
    absent = np.full(len(model.carriers), np.nan)
    return step(model, state, state.epoch_us + step_us, absent, known or no_motion(), declared=declared).state


def quiet_effective_rows(rows: int, carriers: int, period_us: int, seed: int) -> list[EffectiveRow]:
    """Return what a filter did with rows that hold noise alone."""
    model, rng = carrier_model(carriers=carriers), np.random.default_rng(seed)
    settings, state, found = FilterSettings(), start(model, 0, aligned(model)), []
    compiled = filter_model(model, settings)
    for _ in range(rows):
        level_db = model.white_sigma_db * rng.standard_normal(carriers)
        before, epoch_us = state, state.epoch_us + period_us
        result = step(compiled, state, epoch_us, level_db, no_motion())
        state = result.state
        origin = np.arange(len(state.mean))
        found.append(effective_row(model, settings, before, result.state, result.row, result.trace, origin))
    return found


def innovated(
    model: FilterModel, gaussian: Gaussian, deviation_db: FloatArray, carriers: IntArray | None = None
) -> Innovation:
    """Return the innovations of some carriers, of all without a choice, linearised at the state's own attitude."""
    chosen = np.arange(len(model.carriers)) if carriers is None else carriers
    white_db2 = model.carriers["white_sigma_db"][chosen] ** 2
    return innovate(model, *gaussian, deviation_db, chosen, white_db2, gaussian.mean[ATTITUDE].copy())


class Updated(NamedTuple):
    """State after an update, normalised innovation squared and shift (3,) of the attitude in sigmas."""

    state: FilterState
    nis: float
    shift: FloatArray


def updated(model: FilterModel, state: FilterState, deviation_db: FloatArray, innovation: Innovation) -> Updated:
    """Return the update of a state; the state given stays."""
    after, shift, found = copied(state), np.zeros(3), empty_result(1, len(model.carriers)).rows[0]
    is_done, nis = update_state(model, after, deviation_db, innovation, shift, found, empty_trace(0, 0, 0))
    assert is_done
    return Updated(after, nis, shift)


def reference_states(model: CarrierModel, carriers: IntArray, hidden: int = 0) -> IntArray:
    """Return the places (n,) of the reference errors of some carriers: the last of their states."""
    return carrier_states(model, carriers, hidden)[-1]
