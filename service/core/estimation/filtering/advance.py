"""Rows of the attitude filter one after another: the compiled entry, and what it leaves of each row.

Live is a block of one row. A row works on a second set of arrays that takes the place of the first where the row went
well, so that one whose numbers are lost leaves the state as before it, and the rows after it go on.
"""

import numpy as np

from service.core.compiled_entry import CompiledEntry
from service.core.estimation.filtering import (
    anchor,
    carrier_watch,
    command_watch,
    common_cause,
    filter_model,
    filter_state,
    integrity,
    motion,
    motion_sensor,
    motion_watch,
    plant,
    polarimeter,
    prediction,
    rate_sensor,
    row,
    row_block,
    sensor_records,
    wheel_momentum,
)
from service.core.estimation.filtering.filter_state import FilterState
from service.core.estimation.filtering.plant import TORQUES, FilterModel
from service.core.estimation.filtering.prediction import hidden_states
from service.core.estimation.filtering.row_block import BlockResult, RowBlock, RowTrace, empty_trace

_TAKE_ROWS = CompiledEntry(
    row.take_rows,
    (
        filter_model,
        filter_state,
        plant,
        row_block,
        motion,
        prediction,
        carrier_watch,
        common_cause,
        command_watch,
        motion_watch,
        anchor,
        integrity,
        motion_sensor,
        polarimeter,
        wheel_momentum,
        rate_sensor,
        sensor_records,
        row,
    ),
)


def advance(
    model: FilterModel,
    state: FilterState,
    block: RowBlock,
    result: BlockResult,
    trace: RowTrace | None = None,
) -> FilterState:
    """Return the state after a block of rows, whose results are written.

    Parameters
    ----------
    model : FilterModel
        Carriers and spacecraft.
    state : FilterState
        Before; it is not changed.
    block : RowBlock
        Rows in order.
    result : BlockResult
        Written; a row whose numbers are lost has the status `LOST` and leaves the state as it was.
    trace : RowTrace, optional
        Written with the newest row, with room as `empty_trace` makes it.

    Raises
    ------
    ValueError
        The state has other shares than there are commands.
    """
    _check_shares(model, state, block)
    one = _like(state)
    buffers = one, _like(state) if len(block.rows) > 1 else state
    newest = _TAKE_ROWS(model, state, *buffers, block, result, _NO_TRACE if trace is None else trace)
    return (state, *buffers)[newest]


def _check_shares(model: FilterModel, state: FilterState, block: RowBlock) -> None:
    hidden, shares, one = hidden_states(model, len(state.mean)), block.unreported.shape[1], model.plant[0]
    torques = hidden - shares - int(one["sensor_states"])
    if torques != TORQUES * one["has_torque"] and (one["has_wheels"] or torques not in (0, TORQUES)):
        message = f"{shares} commands are unreported, which does not fit {hidden} hidden states"
        raise ValueError(message)


_NO_TRACE = empty_trace(0, 0, 0)


def _like(state: FilterState) -> FilterState:
    """Return arrays of the shapes of a state, their numbers undefined."""
    return FilterState._make([np.empty_like(each, order="C") for each in state])
