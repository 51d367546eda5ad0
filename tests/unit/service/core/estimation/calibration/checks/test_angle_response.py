"""Response of a polarimeter's angle to the turns: sign and scale."""

import math

import numpy as np
import pytest
from turned_wheels import turned_deg

from service.core.estimation.calibration.checks.angle_response import AngleResponse, angle_response

SIGHT = np.array([0.99, -0.07, -0.13])


def response(seed: int, scale: float = 1.0, *, turns: float = 1.0) -> AngleResponse:
    """Return the response of an angle of a scale with noise, offset, drift and wander."""
    rng, angles = np.random.default_rng(seed), turns * turned_deg()
    hours = np.arange(len(angles)) / 60.0
    wander = np.convolve(rng.normal(0.0, 0.04 * math.sqrt(1 / 60.0), len(angles)), np.exp(-hours / 4.0))[: len(angles)]
    measured = scale * angles @ SIGHT + 1.3 + 0.03 * np.cos(0.26 * hours) + wander + rng.normal(0.0, 0.07, len(angles))
    measured[7] = math.nan
    return angle_response(hours, measured, (angles + rng.normal(0.0, 0.01, angles.shape)) @ SIGHT)


@pytest.mark.parametrize("seed", range(1, 21))
def test_a_true_instrument_agrees_and_a_wrong_one_does_not(seed: int) -> None:
    found = response(seed)
    print(f"seed {seed}", found, found.deviation())
    assert found.is_determined
    assert found.deviation() < 3.5
    for scale in (-1.0, 0.5, 1.5, 2.0):
        assert response(seed, scale).deviation() > 3.5


def test_turns_that_tell_nothing_determine_nothing() -> None:
    assert not response(1, turns=0.0).is_determined
    assert response(1, turns=0.0).deviation() == 0.0
    few = angle_response(np.arange(5.0), np.arange(5.0), np.arange(5.0))
    assert math.isnan(few.sigma)
    assert few.deviation() == 0.0
    nothing = angle_response(np.arange(3.0), np.full(3, np.nan), np.zeros(3))
    assert math.isnan(nothing.coefficient)
