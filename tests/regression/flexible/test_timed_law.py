"""Timed pulses on a swinging body: a swing may move a pulse, it does not make a chatter of them."""

from itertools import product

import pytest

from service.core.flexible.motion import follow_motion
from service.core.flexible.propagation import BodyState
from service.core.flexible.spacecraft import HubMode
from service.study.limit_cycles import reference
from service.study.limit_cycles.cycle_tables import cycle_of


def firings(mode: HubMode, amplitude_rad: float) -> int:
    """Return the pulses of four periods of cycle A0, the one at the start included."""
    cycle, drive = cycle_of("A0"), reference.BASE
    momentum = drive.momentum_n_m_s - drive.inertia_kg_m2 * cycle.speed_rad_s
    start = BodyState(-reference.BETA_RAD + amplitude_rad, -cycle.speed_rad_s, -amplitude_rad, momentum_n_m_s=momentum)
    law = reference.law_of(1, 1e-3)
    return len(follow_motion(start, drive, mode, law, 4.0 * cycle.period_s).firing_times_s)


@pytest.mark.slow
def test_sixty_starts_fire_as_often_as_a_rigid_body_give_or_take_one() -> None:
    grid = product((0.3, 0.6, 1.0, 2.0, 4.0), (0.1, 0.5, 1.0, 2.0), (0.0, 2e-3, 5e-3))
    counts = [firings(HubMode(omega, 0.005, coupling), swing) for omega, coupling, swing in grid]
    assert len(counts) == 60
    assert set(counts) <= {4, 5, 6}
    assert counts.count(5) >= 40
