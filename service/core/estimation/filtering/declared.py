"""Declared operations of a step: they explain a change or mask carriers for a while.

The law of this file: arrays in the terms of the filter; the pipeline translates operations into them.
One-time values belong to the first row at or after the instant they are declared for.
"""

from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray


class Declared(NamedTuple):
    """Effect of the declared operations on one step; triples in the order yaw, roll, pitch."""

    #: (N,) carriers that are not to be used
    is_masked: BoolArray
    #: (N,) dB, white noise in addition
    white_db: FloatArray
    #: (N,) dB/sqrt(h), walk of the references in addition
    reference_walk_db: FloatArray
    #: dB/sqrt(h), walk of the receiving chain in addition
    chain_walk_db: float
    #: (3,) deg/sqrt(h), walk of the attitude in addition
    attitude_walk_deg: FloatArray
    #: (N,) dB, one time: each reference may have moved by this on its own
    reference_step_db: FloatArray
    #: (G,) dB, one time: the references of each transponder may have moved together by this
    group_step_db: FloatArray
    #: dB, one time: the receiving chain may have moved by this
    chain_step_db: float
    #: (3,) deg, one time: the attitude may have moved by this
    attitude_step_deg: FloatArray


def nothing_declared(carriers: int, transponders: int) -> Declared:
    """Return the effect of no operation.

    Parameters
    ----------
    carriers, transponders : int
        N and G.
    """
    none, still = np.zeros(carriers), np.zeros(3)
    return Declared(
        np.zeros(carriers, dtype=np.bool_), none, none, 0.0, still, none, np.zeros(transponders), 0.0, still
    )
