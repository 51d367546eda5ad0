"""T5: a relay that holds its own oscillation, and those that come free."""

import pytest

from service.core.flexible.capture.capture import SwitchOn, perpetual_amplitude_rad
from service.core.flexible.spacecraft import HubMode
from service.study.limit_cycles import reference
from service.study.limit_cycles.capture_tables import agrees_with_published, perpetual_lock
from service.study.limit_cycles.reference import PerpetualCase


def limit_rad(case: PerpetualCase) -> float:
    switch = SwitchOn(2e-4, 0.0, 1e-4, reference.ALPHA_RAD, reference.BETA_RAD)
    return perpetual_amplitude_rad(switch, HubMode(case.omega_rad_s, case.damping_ratio, case.coupling))


@pytest.mark.parametrize(
    "case",
    reference.PERPETUAL,
    ids=lambda case: f"w{case.omega_rad_s:g}-kn{case.coupling:g}-xi{case.damping_ratio:g}-p{case.amplitude_rad:g}",
)
def test_a_run_of_150_periods_ends_as_told(case: PerpetualCase) -> None:
    # printed with two decimals
    assert limit_rad(case) / reference.BETA_RAD == pytest.approx(case.lock_ratio, abs=6e-3)
    lock = perpetual_lock(case)
    assert agrees_with_published(case, lock, limit_rad(case)), lock
    if case.is_captured:
        assert lock.firings_per_period == pytest.approx(case.firings_per_period, abs=0.021)
        assert lock.amplitude_rad == pytest.approx(case.final_amplitude_rad, rel=1e-2)


def test_a_run_that_locks_is_not_taken_for_a_free_one() -> None:
    locked = next(case for case in reference.PERPETUAL if case.is_captured)
    free = locked._replace(is_captured=False)
    assert not agrees_with_published(free, perpetual_lock(locked), limit_rad(locked))
