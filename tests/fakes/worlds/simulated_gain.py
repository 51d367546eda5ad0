"""Gain of the simulated payload against its nominal attitude and place."""

import numpy as np

from analyzer_sim.streams import FloatArray
from analyzer_sim.world.orbit import EpochArray, Orbit
from analyzer_sim.world.payload.carriers import CarrierPlan
from analyzer_sim.world.payload.level_terms import flown_gain_db, nominal_gain_db


def attitude_gain_db(
    plan: CarrierPlan,
    orbit: Orbit,
    epochs_us: EpochArray,
    attitude_deg: FloatArray,
    shift_deg: FloatArray | None = None,
) -> FloatArray:
    """Return the change of gain (T, N) against nominal attitude and place; `shift_deg` as in `pattern_gain_db`."""
    gain_db = flown_gain_db(plan, orbit, epochs_us, attitude_deg, shift_deg)
    return gain_db - nominal_gain_db(plan, orbit, np.zeros((1, 3)))
