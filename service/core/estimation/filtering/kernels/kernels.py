"""Kernels of the anchor, as numpy runs them or compiled."""

from collections.abc import Callable
from typing import NamedTuple

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.filtering.kernels import anchor_kernels


class AnchorKernels(NamedTuple):
    """Functions of `anchor_kernels`."""

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


ARRAYS = AnchorKernels(anchor_kernels.mix, anchor_kernels.levels)
