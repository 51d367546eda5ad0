"""Bounds of undetected faults at their limits."""

import numpy as np
import pytest

from service.core.estimation.snapshot.fault_bounds import GATE_SIGMAS, fault_bounds


def test_a_carrier_that_nothing_checks_has_no_bound():
    """Leverage one: infinite for the angle it moves, nothing for the others; absent carriers are NaN."""
    design = np.eye(4)[np.newaxis]
    bounds = fault_bounds(design, np.swapaxes(design, 1, 2), np.array([[0.1, 0.1, 0.1, np.nan]]))
    assert np.isinf(bounds.detectable_db[0, :3]).all()
    assert np.isnan(bounds.detectable_db[0, 3])
    assert bounds.shift_deg[0, 0].tolist() == [np.inf, 0.0, 0.0]


def test_a_carrier_without_leverage_is_seen_at_gate_and_quantile():
    """No leverage: gate plus 1.28 sigmas, and no shift."""
    bounds = fault_bounds(np.zeros((1, 1, 4)), np.zeros((1, 4, 1)), np.array([[0.2]]))
    assert bounds.detectable_db[0, 0] == pytest.approx(0.2 * (GATE_SIGMAS + 1.2815515655446), rel=1e-12)
    assert not bounds.shift_deg.any()
