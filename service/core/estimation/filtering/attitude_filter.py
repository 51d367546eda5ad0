"""One row of the attitude filter as its callers see it: the state after it and what it says."""

from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.filtering.advance import advance
from service.core.estimation.filtering.common_cause import CAUSES, Cause
from service.core.estimation.filtering.declared import Declared
from service.core.estimation.filtering.filter_model import KnownMotion
from service.core.estimation.filtering.filter_state import FilterState
from service.core.estimation.filtering.integrity import Integrity, integrity_of
from service.core.estimation.filtering.plant import FilterModel
from service.core.estimation.filtering.prediction import hidden_states
from service.core.estimation.filtering.row_block import (
    LOST,
    BlockResult,
    RowTrace,
    empty_block,
    empty_result,
    empty_trace,
    write_declared,
    write_known,
)


class FilterStep(NamedTuple):
    """State after a row and the result of the row."""

    state: FilterState
    #: (3,) deg and (3, 3) deg^2
    attitude_deg: FloatArray
    covariance_deg2: FloatArray
    #: (3,) deg, levels that the error passes with a probability of 1e-4, NaN = not known
    protection_deg: FloatArray
    #: (3,) deg, those levels if nothing were wrong with any carrier
    nominal_deg: FloatArray
    #: (3,) deg, loss by two hours without control
    waiting_loss_deg: FloatArray
    #: (N,) dB, NaN = absent or flagged
    innovation_db: FloatArray
    #: (n,) carriers used
    used: IntArray
    cause: Cause | None
    common_db: float
    rain_db: float
    integrity: Integrity
    #: (N,) dB, measured minus what attitude, chain, rain and common parts explain; NaN = absent
    residual_db: FloatArray
    #: whether nothing was found or declared
    is_ordinary: bool = True
    #: what rain below zero was raised by, dB, and variance of rain after the update, dB^2
    rain_raised_db: float = 0.0
    rain_variance_db2: float = 0.0
    #: step and update as they acted, where they were asked for
    trace: RowTrace | None = None


def step(
    model: FilterModel,
    state: FilterState,
    epoch_us: int,
    deviation_db: FloatArray,
    known: KnownMotion,
    *,
    declared: Declared | None = None,
    reported_wet: FloatArray | None = None,
    is_traced: bool = False,
) -> FilterStep:
    """Return the filter after one row.

    Parameters
    ----------
    model : FilterModel
        Carriers and spacecraft.
    state : FilterState
        State before; it is not changed.
    epoch_us : int, microseconds UTC
        Epoch of the row; a row that is not newer than the state changes nothing.
    deviation_db : ndarray, shape (N,), dB
        Measured minus reference minus harmonic, NaN = absent.
    known : KnownMotion
        What was commanded since the state's epoch.
    declared : Declared, optional
        What the ground declared about the time since the state's epoch.
    reported_wet : ndarray, shape (N,), optional
        1 where rain over the carrier's station is reported, 0 where none is, NaN where nobody says.
    is_traced : bool
        Whether step and update are kept, for a smoother.

    Returns
    -------
    FilterStep
        New state, attitude, what was used, whether control may use it.

    Raises
    ------
    ArithmeticError
        The numbers of the filter were lost in the row.
    """
    carriers, states = len(model.carriers), len(state.mean)
    block, result = empty_block(1, carriers, len(known.unreported)), empty_result(1, carriers)
    block.rows["epoch_us"], block.carriers["deviation_db"] = epoch_us, deviation_db
    write_known(block, 0, known)
    if reported_wet is not None:
        block.carriers["reported_wet"] = reported_wet
    if declared is not None:
        write_declared(model, block, 0, declared)
    trace = empty_trace(states, hidden_states(model, states), carriers) if is_traced else None
    after = advance(model, state, block, result, trace)
    if result.rows["status"][0] == LOST:
        message = "the filter lost its numbers; the state before this row is kept"
        raise ArithmeticError(message)
    return filter_step(after, result, 0, trace)


def filter_step(state: FilterState, result: BlockResult, number: int, trace: RowTrace | None = None) -> FilterStep:
    """Return a row of a block as a record; the state is the one after it."""
    row, carriers = result.rows[number], result.carriers[number]
    return FilterStep(
        state,
        row["attitude_deg"],
        row["covariance_deg2"],
        row["protection_deg"],
        row["nominal_deg"],
        row["waiting_loss_deg"],
        carriers["innovation_db"],
        np.flatnonzero(carriers["is_used"]),
        CAUSES[row["cause"]],
        float(row["chain_db"]),
        float(row["rain_db"]),
        integrity_of(int(row["reasons"]), bool(row["is_yaw_allowed"]), bool(row["is_realignment_advised"])),
        carriers["residual_db"],
        not row["has_event"],
        float(row["rain_raised_db"]),
        float(row["rain_variance_db2"]),
        trace,
    )
