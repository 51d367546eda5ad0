"""Stages of a row of the filter as numpy runs them, or compiled.

``ARRAYS`` needs numpy alone; ``compiled_kernels()`` costs the import of numba. Both are one source. The law of this
file: a set is chosen once, where the program is put together, and handed down; the sets agree to rounding, and each
gives the same bits for the same row: no sum is reordered, nothing runs in parallel.
"""

import hashlib
import operator
from collections.abc import Callable
from functools import lru_cache
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

import numpy as np

from service.core.estimation.filtering import filter_predict, filter_update
from service.core.estimation.filtering.anchor import anchor_watch
from service.core.estimation.filtering.causes import (
    carrier_faults,
    common_cause,
    common_change,
)
from service.core.estimation.filtering.filter_records import FilterState
from service.core.estimation.filtering.kernels import anchor_kernels, kernels, state_kernels
from service.core.estimation.filtering.model import filter_model, step_inputs
from service.core.estimation.filtering.model.filter_model import CarrierModel
from service.core.estimation.filtering.rows import row_stages
from service.core.estimation.filtering.watches import (
    command_watch,
    drift_watch,
    minute_sums,
    motion_watch,
    noise_watch,
)

#: modules whose functions the stages call
_SOURCES: tuple[ModuleType, ...] = (
    filter_predict,
    filter_update,
    row_stages,
    anchor_watch,
    carrier_faults,
    common_cause,
    common_change,
    filter_model,
    step_inputs,
    command_watch,
    drift_watch,
    minute_sums,
    motion_watch,
    noise_watch,
    anchor_kernels,
    state_kernels,
)


#: models that are held at once, each with its newest state: one a spacecraft and calibration, some 0.2 MB
_MOST_MODELS = 64


class RowKernels(NamedTuple):
    """Stages of a row; their docstrings are those of `filter_predict` and `row_stages`."""

    move_state: filter_predict.Mover
    ordinary_row: Callable[..., row_stages.OrdinaryRow]
    anchor: kernels.AnchorKernels


ARRAYS = RowKernels(filter_predict.move_state, row_stages.ordinary_row, kernels.ARRAYS)


@lru_cache(maxsize=1)
def compiled_kernels() -> RowKernels:
    """Return the compiled set; a stage is compiled at its first call, or read from what an earlier process kept."""
    # the import costs a quarter of a second: only a program that filters pays it
    from numba import config
    from numba.extending import register_jitable

    from service.core.estimation.filtering.rows import held_values
    from service.core.machine_code import compiled

    # half of the compiler's time, and rows as fast: loops over some carriers gain nothing by vector code or more passes
    for setting, level in (("LOOP_VECTORIZE", 0), ("SLP_VECTORIZE", 0), ("OPT", 1)):
        setattr(config, setting, type(getattr(config, setting))(level))

    sources = (*_SOURCES, held_values)
    for module in sources:
        for part in vars(module).values():
            if isinstance(part, FunctionType) and part.__module__ == module.__name__:
                register_jitable(part)
    digest = _digest(sources)
    stages = (filter_predict.move_state, held_values.held, held_values.held)
    mover, hold_model, hold_state = (_Stage(compiled(_entry(stage, digest))) for stage in stages)
    taken = _Stage(compiled(held_values.row_of_held(digest)))
    anchor = kernels.AnchorKernels(compiled(anchor_kernels.mix), compiled(anchor_kernels.levels))
    return RowKernels(mover, _HeldRows(hold_model, hold_state, taken), anchor)


def _digest(modules: tuple[ModuleType, ...]) -> str:
    """Return a digest of the sources: numba itself asks only the file of a stage whether its machine code is old."""
    # the loader of a module has its source wherever it was installed
    sources = (vars(module)["__loader__"].get_source(module.__name__) for module in modules)
    return hashlib.sha256("".join(map(str, sources)).encode()).hexdigest()


def _entry(stage: Callable[..., Any], digest: str) -> Callable[..., Any]:
    """Return a stage under the digest of its sources, which numba counts among the marks of kept machine code."""

    def run(*args: Any) -> Any:
        return stage(*args) if digest else None

    return run


class _Stage:
    """A compiled stage: one form of arguments is compiled, others are brought into it.

    Arrays that were restored or cut out of others are other types to numba, and each would be compiled again.
    """

    def __init__(self, compiled: Any) -> None:
        self._compiled = compiled
        self._is_compiled = False

    def __call__(self, *args: Any) -> Any:
        """Return what the stage makes of the arguments."""
        if not self._is_compiled:
            result = self._compiled(*_plain(args))
            self._compiled.disable_compile()
            self._is_compiled = True
            return result
        try:
            return self._compiled(*args)
        except TypeError:
            return self._compiled(*_plain(args))


class _HeldRows:
    """The compiled ordinary row: model and newest state stay in compiled code, and are found again by identity."""

    def __init__(self, hold_model: _Stage, hold_state: _Stage, taken: _Stage) -> None:
        self._hold_model, self._hold_state, self._taken = hold_model, hold_state, taken
        #: model, its handle, its newest state and the handle of that, by identity of the model
        self._kept: dict[int, tuple[CarrierModel, Any, FilterState, Any]] = {}

    def __call__(
        self, model: CarrierModel, state: FilterState, step: step_inputs.StepInputs, *rest: Any
    ) -> row_stages.OrdinaryRow:
        """Return the row as `ordinary_row` does."""
        found = self._kept.get(id(model))
        held_model = found[1] if found is not None else self._hold_model(_plain(model))
        is_newest = found is not None and _is_followed(found[2], state)
        held_state = found[3] if found is not None and is_newest else self._hold_state(state)
        row: row_stages.OrdinaryRow
        changed = state.gaussian, state.drift, state.beyond_until_us
        row, handle = self._taken(held_model, held_state, *changed, step, *rest)
        if found is None and len(self._kept) >= _MOST_MODELS:
            self._kept.clear()
        self._kept[id(model)] = model, held_model, row.state, handle
        return row


def _is_followed(held: FilterState, state: FilterState) -> bool:
    """Return whether a state is the one held, but for what is given beside it."""
    if held is state:
        return True
    given = state._replace(
        gaussian=held.gaussian, drift=held.drift, command=held.command, beyond_until_us=held.beyond_until_us
    )
    return all(map(operator.is_, given, held))


def _plain(value: Any) -> Any:
    """Return arguments whose arrays can be written and stand in one piece of memory."""
    if isinstance(value, np.ndarray):
        return np.require(value, requirements=["C", "W"])
    if isinstance(value, tuple):
        parts = [_plain(each) for each in value]
        return type(value)(*parts) if hasattr(value, "_fields") else type(value)(parts)
    return value
