"""Rows of a made-up payload that compile the robust filter, so that no first row of a spacecraft waits for it.

Run ``python -m service.pipeline.first_rows`` after an installation; it takes a minute, and a second where the machine
code is there already.
"""

import numpy as np

from service.core.estimation.filtering.attitude_filter import step
from service.core.estimation.filtering.filter_model import (
    CarrierModel,
    initial_gaussian,
    no_motion,
)
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.plant import filter_model

_MINUTE_US = 60_000_000
#: more than the anchor waits between two answers
_ROWS = 30


def compile_filter() -> None:
    """Filter half an hour of eight carriers."""
    model, random = _payload(8), np.random.default_rng(1)
    sigma_deg, sigma_db = np.full(3, 0.01), np.full(model.carriers, 0.03)
    aligned = initial_gaussian(model, np.zeros(3), sigma_deg, sigma_db, drift_deg_h=(0.1, 0.1, 0.1))
    state = start(model, 0, aligned)
    arrays = filter_model(model)
    for row in range(1, _ROWS + 1):
        deviation_db = random.normal(0.0, 0.1, model.carriers)
        state = step(arrays, state, row * _MINUTE_US, deviation_db, no_motion()).state


def _payload(carriers: int) -> CarrierModel:
    """Return a model of some carriers; its figures matter no more than that the filter runs."""
    across, one = np.linspace(-1.0, 1.0, carriers), np.ones(carriers)
    return CarrierModel(
        gradient_db_deg=np.column_stack([0.1 * across, 1.0 - across**2, across]),
        hessian_db_deg2=np.zeros((carriers, 3, 3)),
        rain_share=one,
        transponder=np.arange(carriers, dtype=np.int64) % 2,
        white_sigma_db=0.1 * one,
        coloured_sigma_db=0.05 * one[:, None],
        coloured_tau_s=3600.0 * one[:, None],
        reference_walk_db=0.01 * one,
        common_sigma_db=np.zeros(0),
        common_tau_s=np.zeros(0),
        coefficient_covariance=np.tile(1e-4 * np.eye(9), (carriers, 1, 1)),
    )


if __name__ == "__main__":
    compile_filter()
