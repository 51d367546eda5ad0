"""Hypotheses of small sets of carriers for the tests of the anchor: every figure is chosen."""

import numpy as np

from service.core.estimation.filtering.anchor import Branches

PRIOR = np.array([0.2, 0.1, 0.1, 0.15])
MEAN_DB = np.array([0.0, -0.35, -1.3, 0.0, 0.4])
SPREAD_DB = np.array([0.0, 0.2, 0.9, 1.0, 0.1])
CALM, STORM = (0.87, 0.04, 0.04, 0.01, 0.04), (0.5, 0.2, 0.2, 0.06, 0.04)


def branches(carriers, calm=CALM, storm=STORM, sigma_db=0.08):
    sure = sigma_db * np.linspace(0.8, 1.2, carriers)[:, None]
    return Branches(
        np.tile(MEAN_DB, (carriers, 1)),
        sure**2 + SPREAD_DB**2,
        np.log(np.array([np.tile(calm, (carriers, 1)), np.tile(storm, (carriers, 1))])),
        np.log([0.8, 0.2]),
    )


def jacobian(rng, carriers):
    return np.column_stack([rng.normal(0.0, [0.16, 1.4, 1.2], (carriers, 3)), np.ones(carriers)])
