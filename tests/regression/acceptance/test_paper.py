"""Acceptance tests 2, 5, 9 and 15 by both methods over one world: what the paper method does beside the robust one."""

import numpy as np
import pytest
from driven_world import DrivenWorld, shared_world

from service.records.catalogue import Method
from service.records.levels.attitude import Status

SEED = 12
METHODS = (Method.ROBUST, Method.PAPER)


@pytest.mark.slow
def test_the_paper_method_goes_through_octants():
    """Bounds of the paper method on `octants`; an answer on every settled row, so no row cycles; no rain is told."""
    reported = shared_world("octants", SEED).fly(method=Method.PAPER)
    settled = reported.between(1.0)
    rms = reported.rms_deg(1.0)
    slope = np.polyfit(reported.truth_deg[settled, 0], reported.estimate_deg[settled, 0], 1)[0]
    print(f"octants seed {SEED}: paper rms {rms.round(3)}, yaw slope {slope:.2f}")
    assert all(
        row.status is Status.ACQUIRED for row, is_settled in zip(reported.rows, settled, strict=True) if is_settled
    )
    assert not reported.is_fade.any()
    assert rms[1] <= 0.08
    assert rms[2] <= 0.10


@pytest.mark.slow
def test_the_order_of_the_carriers_does_not_matter_from_calibration_to_attitude(tmp_path):
    """Acceptance test 15: another order in the plan, calibrated, aligned and flown again by both methods."""
    straight = shared_world("nominal", 5)
    order = np.random.default_rng(SEED).permutation(16)
    shuffled = DrivenWorld(straight.simulated.scenario, 5, tmp_path, order=order)
    assert shuffled.documents.plans[1].carrier_ids != straight.documents.plans[1].carrier_ids
    for method in METHODS:
        one, other = (world.fly(until_h=3.0, method=method) for world in (straight, shuffled))
        # sums in another order: the stated bound
        np.testing.assert_allclose(other.estimate_deg, one.estimate_deg, atol=1e-9)
        np.testing.assert_allclose(other.sigma_deg, one.sigma_deg, atol=1e-9)
