"""Response of the momentum to the turns: true telemetry has 1 on every axis, wrong telemetry another one."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from turned_wheels import ALIKE, INERTIA_KG_M2, WRONG, Turned, turned_wheels

from analyzer_sim.world.scenario.story import WheelTelemetry
from service.core.estimation.calibration.checks.momentum_response import MomentumResponse, momentum_response

SEEDS = range(1, 25)


@pytest.fixture(scope="module")
def flights() -> list[Turned]:
    return [turned_wheels(seed) for seed in SEEDS]


def responding(turned: Turned, matrix: Any = None, is_unloading: Any = None) -> MomentumResponse:
    """Return the response of records that report the matrix times the truth."""
    reported = turned.momentum if matrix is None else turned.momentum @ np.asarray(matrix).T
    none = np.zeros(len(reported), dtype=np.bool_)
    epochs_s = (turned.epochs_us - turned.epochs_us[:1]) / 1e6
    flags = none if is_unloading is None else is_unloading
    return momentum_response(epochs_s, reported, turned.attitude_deg, turned.is_slewing, flags, np.array(INERTIA_KG_M2))


def test_true_telemetry_passes_on_every_seed(flights: list[Turned]) -> None:
    found = [responding(turned) for turned in flights]
    sigmas = [one.deviation(0.005) for one in found]
    print(f"seeds 1 to {len(found)}: up to {max(sigmas):.1f} sigma")
    assert all(one.is_determined for one in found)
    assert max(sigmas) < 3.5
    normal = np.array([(one.coefficient - 1.0) / one.sigma for one in found])[:, [0, 2]]
    assert 0.6 < np.sqrt(np.mean(normal**2)) < 1.5


@pytest.mark.parametrize("name", WRONG)
def test_wrong_telemetry_deviates_on_every_seed(flights: list[Turned], name: str) -> None:
    sigmas = [responding(turned, WRONG[name]).deviation(0.005) for turned in flights]
    print(f"{name}: at least {min(sigmas):.1f} sigma")
    assert min(sigmas) > 5.0


@pytest.mark.parametrize("name", ALIKE)
def test_a_factor_that_all_axes_share_moves_the_mean_alone(flights: list[Turned], name: str) -> None:
    right, wrong = responding(flights[0]), responding(flights[0], ALIKE[name] * np.eye(3))
    assert wrong.deviation(0.005) < 4.0
    np.testing.assert_allclose(wrong.mean_n_m_s, ALIKE[name] * right.mean_n_m_s)


def test_telemetry_of_another_spacecraft_deviates(flights: list[Turned]) -> None:
    rng = np.random.default_rng(4)
    for turned in flights:
        other = np.array([0.4, -9.0, 0.3]) + 0.01 * rng.normal(size=turned.momentum.shape)
        assert responding(turned._replace(momentum=other)).deviation(0.005) > 5.0


@pytest.mark.parametrize("records", [6, 24])
def test_telemetry_that_is_late_deviates_or_tells_nothing(flights: list[Turned], records: int) -> None:
    for turned in flights:
        before = turned.momentum[0] + 0.01 * np.random.default_rng(5).normal(size=(records, 3))
        found = responding(turned._replace(momentum=np.concatenate([before, turned.momentum[:-records]])))
        assert found.deviation(0.005) > 5.0 or not found.is_determined


def test_without_momentum_along_pitch_nothing_is_determined() -> None:
    for seed in SEEDS:
        found = responding(turned_wheels(seed, replace(WheelTelemetry(), bias_n_m_s=0.0)))
        assert not found.is_determined
        assert found.deviation(0.005) < 3.5


@pytest.mark.parametrize("is_marked", [True, False])
def test_the_longest_stretch_between_unloadings_is_used(is_marked: bool) -> None:
    for seed in SEEDS:
        turned = turned_wheels(seed, start_h=6.0)
        at = int(np.searchsorted(turned.epochs_us, turned.epochs_us[0] + 360 * 60_000_000))
        flags = np.zeros(len(turned.epochs_us), dtype=np.bool_)
        flags[at] = is_marked
        found = responding(turned, is_unloading=flags)
        assert found.stretches <= 2
        assert found.stretches == 2 or not is_marked
        assert found.records < np.count_nonzero(~turned.is_slewing) or not is_marked
        assert found.deviation(0.005) < 3.5


def test_too_few_records_determine_nothing(flights: list[Turned]) -> None:
    few = Turned(*(part[:6] for part in flights[0]))
    found = responding(few)
    assert not found.is_determined
    assert found.deviation(0.005) == 0.0
    assert np.isnan(responding(Turned(*(part[:0] for part in flights[0]))).mean_n_m_s).all()
