"""Torque that gathers in the wheels, from records of quiet days."""

import numpy as np
import pytest

from service.core.estimation.calibration.gathered_torque import GatheredFit, gathered_torque
from service.core.estimation.filtering.model.filter_model import FilterSettings, MomentumModel

INERTIA = np.array([2600.0, 2600.0, 1400.0])
SETTINGS = FilterSettings(
    momentum=MomentumModel(0.01, 0.005, 0.05, (2600.0, 2600.0, 1400.0), unknown_torque_deg_h2=(5.7, 5.7, 10.6))
)
#: constant, cosine, sine, each yaw, roll, pitch, N m; misalignment of roll and yaw, deg; scales
TRUTH = np.array([4e-6, -3e-6, 5e-6, 8e-6, 2e-6, -6e-6, -3e-6, 9e-6, 4e-6, 0.04, -0.03, 0.003, -0.004])
START_US, STEP_US = 1_793_491_200_000_000, 300_000_000
ORBIT_RAD_S, DAY_RAD_S = 7.292115e-5, 2.0 * np.pi / 86_400.0
#: of the integration: Euler's error of three days is a tenth of a record's noise
_STEP_S = 20
#: momentum that an unloading takes away, N m s along roll, pitch, yaw
UNLOADED = np.array([0.8, -0.1, -1.1])


def acceleration_scale() -> np.ndarray:
    """Return the factors of the thirteen from N m to deg/h^2."""
    return np.concatenate([np.tile(np.degrees(3600.0**2 / INERTIA), 3), np.ones(4)])


def flown(
    seed: int, hours: float = 72.0, unloaded_h: float | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return epochs, records, sensor angles and their noise of a spacecraft integrated in short steps."""
    rng = np.random.default_rng(seed)
    constant, cosine, sine = TRUTH[:9].reshape(3, 3)[:, [1, 2, 0]]
    (bx, bz), (sx, sz) = np.radians(TRUTH[9:11]), TRUTH[11:]
    momentum, epochs, records, angles = np.array([0.3, -8.0, -0.5]), [], [], []
    count = round(hours * 12.0)
    wander = np.cumsum(rng.normal(0.0, 0.002, (count, 3)), axis=0) * 0.3
    for k in range(count):
        epoch_us = START_US + k * STEP_US
        if unloaded_h is not None and k == round(unloaded_h * 12.0):
            momentum = momentum - UNLOADED
        yaw, roll, pitch = np.radians(wander[k])
        x, y, z = momentum
        whole = y - INERTIA[2] * ORBIT_RAD_S
        seen = [x + whole * (yaw + bx) - z * pitch, y + z * roll - x * yaw, z - whole * (roll + bz) + x * pitch]
        record = np.array([1.0 + sx, 1.0, 1.0 + sz]) * seen + rng.normal(0.0, 0.01, 3)
        epochs.append(epoch_us)
        records.append(record)
        angles.append(wander[k] + rng.normal(0.0, 0.01, 3))
        for second in range(0, 300, _STEP_S):
            phase = DAY_RAD_S * ((epoch_us / 1e6 + second + 0.5 * _STEP_S) % 86_400.0)
            torque = constant + cosine * np.cos(phase) + sine * np.sin(phase)
            turned = ORBIT_RAD_S * np.array([momentum[2], 0.0, -momentum[0]])
            momentum = momentum + _STEP_S * (turned + torque) + rng.normal(0.0, 2e-5 * np.sqrt(_STEP_S), 3)
    return np.array(epochs), np.array(records), np.array(angles), np.full(3, 0.01)


def learned(
    epochs: np.ndarray, records: np.ndarray, angles: np.ndarray, sigma: np.ndarray, unloading: np.ndarray | None = None
) -> GatheredFit | None:
    marked = np.zeros(len(epochs), dtype=np.bool_) if unloading is None else unloading
    return gathered_torque(epochs, records, angles, sigma, marked, SETTINGS)


def chi_square(found: GatheredFit) -> float:
    off = found.mean - acceleration_scale() * TRUTH
    return float(off @ np.linalg.solve(found.covariance, off))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("unloaded_h", [None, 31.0])
@pytest.mark.parametrize("is_marked", [True, False])
def test_the_torque_is_found_within_its_covariance(seed: int, unloaded_h: float | None, *, is_marked: bool) -> None:
    epochs, records, angles, sigma = flown(seed, unloaded_h=unloaded_h)
    unloading = np.zeros(len(epochs), dtype=np.bool_)
    if unloaded_h is not None:
        unloading[round(unloaded_h * 12.0)] = is_marked
    found = learned(epochs, records, angles, sigma, unloading)
    assert found is not None
    # thirteen degrees of freedom exceed 34.5 once in a thousand
    print(f"seed {seed}: chi-square {chi_square(found):.1f}")
    assert chi_square(found) < 34.5
    # the wave is known to a few per cent of 1e-5 N m, which without records is 1.4e-5
    sigma_n_m = np.sqrt(np.diag(found.covariance))[3:9] / acceleration_scale()[3:9]
    assert (sigma_n_m < 5e-7).all()


def test_two_hours_tell_little_and_say_so() -> None:
    found = learned(*flown(4, hours=2.0))
    assert found is not None
    assert chi_square(found) < 34.5
    prior = np.array([5.7, 5.7, 10.6]) * np.sqrt(0.5)
    assert (np.sqrt(np.diag(found.covariance))[3:6] > 0.3 * prior).all()


def test_records_of_another_spacecraft_in_between_tell_nothing() -> None:
    epochs, records, angles, sigma = flown(5)
    mixed = records.copy()
    mixed[::2] = records[::2] @ np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    assert learned(epochs, mixed, angles, sigma) is None


def test_rows_without_angles_take_no_part() -> None:
    epochs, records, angles, sigma = flown(6, hours=24.0)
    blind = angles.copy()
    blind[::2] = np.nan
    some, fewer = learned(epochs, records, blind, sigma), learned(epochs[1::2], records[1::2], angles[1::2], sigma)
    assert some is not None
    assert fewer is not None
    np.testing.assert_array_equal(some.mean, fewer.mean)
    assert some.records == len(epochs) // 2


def test_settings_without_wheels_are_refused() -> None:
    with pytest.raises(ValueError, match="momentum of wheels"):
        gathered_torque(
            *(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(3)),
            np.zeros(0, dtype=np.bool_),
            FilterSettings(),
        )
