"""Rows of the attitude filter one by one, with what tests ask of each."""

from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.estimation.filtering.advance import advance
from service.core.estimation.filtering.filter_model import KnownMotion
from service.core.estimation.filtering.filter_state import FilterState
from service.core.estimation.filtering.integrity import REASONS
from service.core.estimation.filtering.plant import FilterModel
from service.core.estimation.filtering.prediction import hidden_states
from service.core.estimation.filtering.row_block import (
    LOST,
    RECORD,
    Declared,
    RowTrace,
    empty_block,
    empty_result,
    empty_trace,
    write_declared,
    write_known,
)
from service.core.estimation.filtering.sensor_records import take_records


def records_of(*values: dict[str, object]) -> np.ndarray:
    """Return records (M,) of `RECORD` by the names of their values; others are zero."""
    records = np.zeros(len(values), RECORD)
    for record, each in zip(records, values, strict=True):
        for name, value in each.items():
            record[name] = value
    return records


def after_records(model: FilterModel, state: FilterState, records: np.ndarray, to_us: int) -> FilterState:
    """Return the state after records (M,) of `RECORD` that are due before a row of an epoch."""
    block = empty_block(1, len(model.carriers))._replace(records=records)
    block.rows["epoch_us"], after = to_us, FilterState._make(each.copy() for each in state)
    take_records(model, after, block, 0, empty_trace(0, 0, 0))
    return after


class Verdict(NamedTuple):
    """Permission of control by a row, and the reasons against it."""

    is_control_allowed: bool
    #: (yaw, roll, pitch)
    is_axis_allowed: tuple[bool, bool, bool]
    #: why not, in the order of `REASONS`
    reasons: tuple[str, ...]
    is_realignment_advised: bool


def verdict_of(row: np.void) -> Verdict:
    """Return the verdict in a record of `RESULT`."""
    reasons = int(row["reasons"])
    names = tuple(name for place, name in enumerate(REASONS) if reasons >> place & 1)
    allowed = bool(row["is_yaw_allowed"]), not reasons, not reasons
    return Verdict(not reasons, allowed, names, bool(row["is_realignment_advised"]))


class FilterStep(NamedTuple):
    """State after a row, the row's record of `RESULT`, and those of its carriers (N,)."""

    state: FilterState
    row: np.void
    carriers: np.ndarray
    #: step and update as they acted
    trace: RowTrace

    @property
    def attitude_deg(self) -> FloatArray:
        """Return the angles (3,)."""
        return self.row["attitude_deg"]

    @property
    def sigma_deg(self) -> FloatArray:
        """Return their sigmas (3,)."""
        return self.row["sigma_deg"]

    @property
    def cause(self) -> int:
        """Return the cause of a common change, a constant of `common_cause`."""
        return int(self.row["cause"])

    @property
    def integrity(self) -> Verdict:
        """Return whether control may use it."""
        return verdict_of(self.row)

    @property
    def used(self) -> np.ndarray:
        """Return the carriers used (n,)."""
        return np.flatnonzero(self.carriers["is_used"])


def step(
    model: FilterModel,
    state: FilterState,
    epoch_us: int,
    deviation_db: FloatArray,
    known: KnownMotion,
    *,
    declared: Declared | None = None,
    reported_wet: FloatArray | None = None,
    is_traced: bool = True,
    records: np.ndarray | None = None,
) -> FilterStep:
    """Return the filter after one row of deviations (N,), dB, and the records (M,) of `RECORD` that are due before it.

    Raises
    ------
    ArithmeticError
        Its numbers were lost.
    """
    carriers, states = len(model.carriers), len(state.mean)
    block, result = empty_block(1, carriers, len(known.unreported)), empty_result(1, carriers)
    block.rows["epoch_us"], block.carriers["deviation_db"] = epoch_us, deviation_db
    write_known(block, 0, known)
    if reported_wet is not None:
        block.carriers["reported_wet"] = reported_wet
    if declared is not None:
        write_declared(model, block, 0, declared)
    if records is not None:
        block = block._replace(records=records)
    sizes = (states, hidden_states(model, states), carriers, len(block.records)) if is_traced else (0, 0, 0)
    trace = empty_trace(*sizes)
    after = advance(model, state, block, result, trace)
    if result.rows["status"][0] == LOST:
        message = "the filter lost its numbers"
        raise ArithmeticError(message)
    return FilterStep(after, result.rows[0], result.carriers[0], trace)
