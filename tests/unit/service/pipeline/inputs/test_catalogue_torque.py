"""Torque and momentum of a spacecraft by its catalogue and its calibration."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import FlightPayload

from service.pipeline.inputs.catalogue_torque import momentum_model
from service.pipeline.inputs.known_motion import DEG_H2_N_M, angle_inertia_kg_m2
from service.records.calibration import AxesCheck, Calibration, GatheredTorque, MotionVerdict
from service.records.catalogue import AxisTorques, FedForwardTorque, Spacecraft, WheelMomentum

TORQUE_N_M = (1e-6, 2e-6, 3e-6, 0.0, 1e-5, 0.0, 1e-5, 0.0, -1e-5)
GATHERED = GatheredTorque(
    (*TORQUE_N_M, 0.01, -0.02, 1e-3, 2e-3), tuple(map(tuple, (1e-16 * np.eye(13)).tolist())), 800, 0
)
DAY_US = 86_400_000_000


@pytest.fixture
def spacecraft() -> Spacecraft:
    record = FlightPayload.make(8, 1).spacecraft()
    return replace(record, onboard=replace(record.onboard, momentum=WheelMomentum()))


@pytest.fixture
def calibration() -> Calibration:
    made = FlightPayload.make(8, 1).calibration()
    assert made.result is not None
    return replace(made, result=replace(made.result, gathered=GATHERED))


def test_what_quiet_days_told_takes_the_place_of_the_catalogue(
    spacecraft: Spacecraft, calibration: Calibration
) -> None:
    stated = WheelMomentum(torque=FedForwardTorque(epoch_us=0, constant_n_m=AxisTorques(yaw=1.0)))
    for momentum in (WheelMomentum(), stated):
        record = replace(spacecraft, onboard=replace(spacecraft.onboard, momentum=momentum))
        model = momentum_model(record, calibration)
        assert model is not None
        assert model.learned is not None
        assert model.profile is None
        expected = np.array(TORQUE_N_M) / DEG_H2_N_M / np.tile(angle_inertia_kg_m2(record), 3)
        np.testing.assert_allclose(model.learned.mean[:9], expected, rtol=1e-12)
        assert model.learned.mean[9:] == GATHERED.mean[9:]
        # a sigma of 1e-8 N m is nothing beside what may have changed: a tenth of all, a hundredth of an axis
        sigma = np.sqrt(np.diag(np.array(model.learned.covariance)))[:9]
        np.testing.assert_allclose(sigma, np.hypot(0.1, 0.01) * np.abs(expected), atol=1e-8 / DEG_H2_N_M / 300.0)


def test_it_is_known_less_well_by_the_time(spacecraft: Spacecraft, calibration: Calibration) -> None:
    fresh, old = (momentum_model(spacecraft, calibration, days * DAY_US) for days in (0, 30))
    assert fresh is not None
    assert old is not None
    assert fresh.learned is not None
    assert old.learned is not None
    assert fresh.learned.mean == old.learned.mean
    grown = np.diag(np.array(old.learned.covariance) - np.array(fresh.learned.covariance))
    parts = np.array(fresh.learned.mean[:9]).reshape(3, 3)
    # 1 % a day: in a month 30 % of the whole torque about the axis
    np.testing.assert_allclose(grown[:9], np.tile(0.09 * np.square(parts).sum(axis=0), 3), rtol=1e-2)
    assert (grown[9:] == 0.0).all()


def test_a_profile_that_is_fed_forward_keeps_its_own_error(spacecraft: Spacecraft, calibration: Calibration) -> None:
    onboard = replace(spacecraft.onboard, fed_forward_torque=FedForwardTorque(epoch_us=0))
    record = replace(spacecraft, onboard=onboard)
    assert momentum_model(record, calibration) == momentum_model(record)


def test_telemetry_that_is_contradicted_or_not_used_has_no_model(
    spacecraft: Spacecraft, calibration: Calibration
) -> None:
    assert calibration.result is not None
    check = AxesCheck(MotionVerdict.CONTRADICTED, "wrong")
    wrong = replace(calibration, result=replace(calibration.result, momentum=check))
    assert momentum_model(spacecraft, wrong) is None
    unused = replace(spacecraft, onboard=replace(spacecraft.onboard, momentum=WheelMomentum(used=False)))
    assert momentum_model(unused, calibration) is None
    assert momentum_model(None) is None
