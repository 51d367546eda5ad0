"""Stages of a row of the filter as numpy runs them, or compiled.

``ARRAYS`` needs numpy alone; ``compiled_kernels()`` costs the import of numba. Both are one source. The law of this
file: a set is chosen once, where the program is put together, and handed down; the sets agree to rounding, and each
gives the same bits for the same row: no sum is reordered, nothing runs in parallel.
"""

import hashlib
from collections.abc import Callable
from functools import lru_cache
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

import numpy as np

from service.core.estimation.filtering import filter_predict, filter_update
from service.core.estimation.filtering.anchor import anchor_watch
from service.core.estimation.filtering.causes import (
    carrier_faults,
    carrier_return,
    common_cause,
    common_change,
    rain_state,
)
from service.core.estimation.filtering.kernels import anchor_kernels, kernels, state_kernels
from service.core.estimation.filtering.model import filter_model, filter_state
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
    carrier_return,
    common_cause,
    common_change,
    rain_state,
    filter_model,
    filter_state,
    command_watch,
    drift_watch,
    minute_sums,
    motion_watch,
    noise_watch,
    anchor_kernels,
    state_kernels,
)


class RowKernels(NamedTuple):
    """Stages of a row; their docstrings are those of `filter_predict` and `row_stages`."""

    move_state: filter_predict.Mover
    ordinary_row: Callable[..., row_stages.OrdinaryRow]
    anchor: kernels.AnchorKernels


_STAGES: tuple[Callable[..., Any], ...] = (filter_predict.move_state, row_stages.ordinary_row)
ARRAYS = RowKernels(filter_predict.move_state, row_stages.ordinary_row, kernels.ARRAYS)


@lru_cache(maxsize=2)
def compiled_kernels(*, is_cached: bool = True) -> RowKernels:
    """Return the compiled set; a stage is compiled at its first call, or read from numba's cache.

    Parameters
    ----------
    is_cached : bool
        Keep the machine code beside the source or in the user's cache; False where neither can be written.

    Raises
    ------
    RuntimeError
        There is no place for the cache.
    """
    # the import costs a quarter of a second: only a program that filters pays it
    from numba import config, njit
    from numba.extending import register_jitable

    # less of the compiler's time, and rows as fast: loops over some carriers gain nothing by vector code
    for vector_code in ("LOOP_VECTORIZE", "SLP_VECTORIZE"):
        setattr(config, vector_code, 0)

    for module in _SOURCES:
        for part in vars(module).values():
            if isinstance(part, FunctionType) and part.__module__ == module.__name__:
                register_jitable(part)
    compiler, digest = njit(cache=is_cached, nogil=True, error_model="numpy"), _digest()
    mover, ordinary = (_Stage(compiler(_entry(stage, digest))) for stage in _STAGES)
    anchor = kernels.AnchorKernels(compiler(anchor_kernels.mix), compiler(anchor_kernels.levels))
    return RowKernels(mover, ordinary, anchor)


def _digest() -> str:
    """Return a digest of the sources: numba itself asks only the file of a stage whether its machine code is old."""
    # the loader of a module has its source wherever it was installed
    sources = (vars(module)["__loader__"].get_source(module.__name__) for module in _SOURCES)
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


def _plain(value: Any) -> Any:
    """Return arguments whose arrays can be written and stand in one piece of memory."""
    if isinstance(value, np.ndarray):
        return np.require(value, requirements=["C", "W"])
    if isinstance(value, tuple):
        parts = [_plain(each) for each in value]
        return type(value)(*parts) if hasattr(value, "_fields") else type(value)(parts)
    return value
