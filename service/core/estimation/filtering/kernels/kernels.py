"""Kernels of the filter step: the arithmetic that every row costs, in two sets that do the same.

``ARRAYS`` needs numpy alone; ``compiled_kernels()`` costs the import of numba. The kernels of the anchor are one
source, those of prediction and update are written once more as loops. The law of this file: a set is chosen once, where
the program is put together, and handed down; the sets agree to rounding, and each gives the same bits for the same row:
no sum is reordered, nothing runs in parallel.

Shapes: D states, of them C in front that no single carrier owns, G of these common parts and E hidden; N carriers of K
components each, n of them used in a row.
"""

from collections.abc import Callable
from functools import lru_cache
from types import ModuleType
from typing import Any, NamedTuple

from service.core.estimation.filtering.kernels import anchor_kernels, array_kernels, loop_kernels
from service.core.estimation.filtering.model.filter_model import FloatArray, IntArray


class Kernels(NamedTuple):
    """Functions of a set of kernels; their docstrings are those of `array_kernels` and `anchor_kernels`."""

    fade: Callable[
        [FloatArray, FloatArray, float, float, FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]
    ]
    turn: Callable[[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, int], None]
    model_variance: Callable[[FloatArray, FloatArray], FloatArray]
    add_process_noise: Callable[
        [
            FloatArray,
            FloatArray,
            FloatArray,
            FloatArray,
            FloatArray,
            FloatArray,
            FloatArray,
            float,
            float,
            FloatArray,
            FloatArray,
        ],
        None,
    ]
    linearise: Callable[
        [FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, IntArray, int, int],
        tuple[FloatArray, FloatArray],
    ]
    project: Callable[[FloatArray, FloatArray, IntArray, int], FloatArray]
    spread: Callable[[FloatArray, FloatArray, IntArray, int], FloatArray]
    update_state: Callable[
        [FloatArray, FloatArray, FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]
    ]
    reduce: Callable[[FloatArray, FloatArray], FloatArray]
    mix: Callable[
        [
            FloatArray,
            FloatArray,
            IntArray,
            FloatArray,
            FloatArray,
            FloatArray,
            FloatArray,
            FloatArray,
            int,
        ],
        tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    ]
    levels: Callable[[FloatArray, FloatArray, FloatArray, float], FloatArray]


def sources(rows: ModuleType) -> list[Callable[..., Any]]:
    """Return the kernels as they are written; those of a row stand in `array_kernels` or in `loop_kernels`."""
    return [getattr(anchor_kernels, name, None) or getattr(rows, name) for name in Kernels._fields]


ARRAYS = Kernels(*sources(array_kernels))


@lru_cache(maxsize=2)
def compiled_kernels(*, is_cached: bool = True) -> Kernels:
    """Return the compiled set; a kernel is compiled at its first call, or read from numba's cache.

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
    from numba import njit
    from numba.extending import register_jitable

    for part in anchor_kernels.PARTS:
        register_jitable(part)
    compiler = njit(cache=is_cached, nogil=True, error_model="numpy")
    return Kernels(*(compiler(source) for source in sources(loop_kernels)))
