"""Rates of the body from telemetry beside the turn of the orbit."""

import numpy as np

from service.pipeline.inputs.telemetry_rates import inertial_deg_h
from service.records.levels.attitude import Axes


def test_a_body_that_points_at_the_earth_has_no_rate() -> None:
    still = Axes(0.0, 0.0, -np.rad2deg(7.2921159e-5))
    np.testing.assert_allclose(
        inertial_deg_h([still, Axes(1.0, 2.0, still.pitch)]), [[0, 0, 0], [3600, 7200, 0]], atol=1e-4
    )
    assert inertial_deg_h([]).shape == (0, 3)
