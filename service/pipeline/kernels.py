"""Compiled kernels: of the robust filter by the name that the settings give them, and of the orbital-frame model.

Nothing is compiled before the first row asks: a program that filters nothing does not wait for a compiler.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Literal, TypeVar

from service.core.dynamics.orbital_frame_kernel import Fly, compiled_fly
from service.core.estimation.filtering.rows.row_kernels import ARRAYS, RowKernels, compiled_kernels

_Compiled = TypeVar("_Compiled")


@lru_cache(maxsize=2)
def kernels_named(name: Literal["numba", "numpy"]) -> RowKernels:
    """Return a set of kernels."""
    return ARRAYS if name == "numpy" else _compiled(compiled_kernels)


def flight_kernel() -> Fly:
    """Return the compiled kernel that flies the orbital-frame model."""
    return _compiled(compiled_fly)


def _compiled(compile_: Callable[..., _Compiled]) -> _Compiled:
    """Return compiled kernels; where machine code cannot be kept, every process compiles its own."""
    try:
        return compile_()
    except RuntimeError:
        # a container whose file system is read only: numba finds no place for its cache
        return compile_(is_cached=False)
