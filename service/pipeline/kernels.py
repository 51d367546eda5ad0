"""Kernels of the robust filter by the name that the settings give them.

Nothing is compiled before the first row asks: a program that filters nothing does not wait for a compiler.
"""

from functools import lru_cache
from typing import Literal

from service.core.estimation.filtering.kernels.kernels import ARRAYS, Kernels, compiled_kernels


@lru_cache(maxsize=2)
def kernels_named(name: Literal["numba", "numpy"]) -> Kernels:
    """Return a set of kernels; where machine code cannot be kept, every process compiles its own."""
    if name == "numpy":
        return ARRAYS
    try:
        return compiled_kernels()
    except RuntimeError:
        # a container whose file system is read only: numba finds no place for its cache
        return compiled_kernels(is_cached=False)
