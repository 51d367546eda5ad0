"""T2: succession function, by the map and by the motion itself; where returns lead; basins."""

import numpy as np
import pytest
from flexible_oracles import frictionless_succession

from service.core.flexible.closed_forms import truncated_succession
from service.core.flexible.return_kernels import compiled_follow, follow
from service.core.flexible.succession import succession
from service.study.limit_cycles import reference
from service.study.limit_cycles.cycle_tables import basin_count, followed_arrivals, motion_of, wandering_range


@pytest.mark.parametrize(("name", "speed", "printed"), reference.SUCCESSIONS)
def test_the_next_arrival_of_the_reference(name: str, speed: float, printed: float) -> None:
    assert succession(np.array([speed]), motion_of(name))[0] == pytest.approx(printed, rel=1e-6)


@pytest.mark.parametrize(("speed", "printed"), reference.TRUNCATED_SUCCESSIONS)
def test_the_truncated_equation_gives_another_arrival(speed: float, printed: float) -> None:
    motion = motion_of("A0")
    truncated = truncated_succession(np.array([speed]), motion)[0]
    assert truncated == pytest.approx(printed, rel=1e-6)
    assert succession(np.array([speed]), motion)[0] != pytest.approx(printed, rel=1e-3)


def test_the_closed_form_of_one_pulse_holds_without_viscous_loss() -> None:
    motion = motion_of("A0")._replace(viscous_rate_1_s=0.0)
    speeds = np.array([2e-5, 8e-5, 1.2e-4, 1.6e-4])
    np.testing.assert_allclose(succession(speeds, motion), frictionless_succession(speeds, motion), rtol=1e-12)


def test_the_motion_leg_by_leg_gives_the_arrivals_of_the_map() -> None:
    start, printed = reference.FOLLOWED_ARRIVALS
    found = followed_arrivals("C2", start)
    mapped = follow(np.array([start]), 2, motion_of("C2"))[0]
    np.testing.assert_allclose(found[1:3], printed, rtol=1e-9)
    np.testing.assert_allclose(found[:3], mapped, rtol=1e-10)


@pytest.mark.parametrize(("name", "start", "returns", "printed"), reference.APPROACHES)
def test_where_returns_lead(name: str, start: float, returns: int, printed: float) -> None:
    last = follow(np.array([start]), returns, motion_of(name))[0, -1]
    assert last == pytest.approx(printed, rel=1e-6)


def test_the_unstable_cycle_is_left_and_never_settles() -> None:
    low, high = wandering_range()
    # chaotic: extremes are those of one rounding, the bounds are not
    assert 0.5e-6 < low < 4e-6
    assert 1.94e-4 < high < 1.99e-4


def test_a_law_without_further_lines_loses_the_body() -> None:
    speeds = follow(np.array([1e-4]), 3000, motion_of("A0"))[0]
    assert np.isnan(speeds[-1])


@pytest.mark.slow
def test_basins_and_the_compiled_map() -> None:
    compiled = compiled_follow()
    starts = np.array([2e-5, 1.2e-4, 5e-4])
    for name in ("A4", "B2", "C2"):
        plain = follow(starts, 20, motion_of(name))
        np.testing.assert_allclose(compiled(starts, 20, motion_of(name)), plain, rtol=1e-9)
    counts = {name: basin_count(name, compiled) for name in reference.BASINS}
    assert counts == reference.BASINS
