"""Rates of the body as telemetry states them, made rates beside the turn of the orbit."""

from collections.abc import Sequence

import numpy as np

from service.core.estimation.filtering.model.measured_motion import ORBITAL_RATE_PER_H
from service.records.levels.attitude import Axes, FloatArray

#: turn of the orbit about pitch, which an inertial rate holds, deg/h
_ORBIT_DEG_H = np.array([0.0, 0.0, np.rad2deg(ORBITAL_RATE_PER_H)])


def inertial_deg_h(rates_deg_s: Sequence[Axes]) -> FloatArray:
    """Return inertial rates (n, 3) about yaw, roll, pitch, deg/h; that of pitch without the turn of the orbit.

    A spacecraft that points at the Earth turns by -15.04 deg/h about pitch.
    """
    return np.asarray(3600.0 * np.array(rates_deg_s, dtype=np.float64).reshape(-1, 3) + _ORBIT_DEG_H)
