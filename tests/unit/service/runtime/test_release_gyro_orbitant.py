"""The gyro-orbitant law on the release service: its commands are prepared, and offered to a standing authorisation."""

import math

import pytest
from release_service_driver import ReleaseServiceDriver
from release_storage import SC

from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S
from service.errors import ConflictError
from service.records.catalogue import ControlLaw, GyroOrbitantGains
from service.records.inputs import TelemetryRecord
from service.records.levels.attitude import Axes
from service.records.operations.release import CommandRequest

W0_DEG_S = math.degrees(GEOSTATIONARY_RATE_RAD_S)
GAINS = GyroOrbitantGains(9.9e-4, 2.0, 5.3e-4, 1.1, 3.1e-4, 2.0)
#: a tenth of a degree of yaw, told by the roll rate
RATE = Axes(0.0, -W0_DEG_S * math.radians(0.1), -W0_DEG_S)


@pytest.fixture
def driver() -> ReleaseServiceDriver:
    driven = ReleaseServiceDriver()
    driven.archive.change_spacecraft(law=ControlLaw.GYRO_ORBITANT, gyro_orbitant=GAINS)
    return driven


def reported(driver: ReleaseServiceDriver, rate: Axes | None = RATE) -> None:
    """Let telemetry of this instant come."""
    wheels = (0.0, 0.0, 0.0)
    driver.archive.telemetry.append(
        TelemetryRecord(driver.clock.now, wheel_momentum_n_m_s=wheels, body_rate_deg_s=rate)
    )
    driver.tell()


def test_a_command_of_the_law_is_prepared_confirmed_and_released(driver: ReleaseServiceDriver) -> None:
    driver.armed()
    driver.prove("yaw")
    reported(driver)
    command = driver.prepare()
    assert all(check.is_ok for check in command.checks)
    assert command.stop_us - command.start_us <= 900_000_000
    # the roll of the row is 0.06 deg, its yaw 0.02; pitch would fill no pulse
    impulse = command.impulse_n_m_s
    assert impulse.yaw < 0.0
    assert impulse.roll < 0.0
    assert impulse.pitch == 0.0
    assert driver.confirm(command).state == "RELEASED"


def test_without_a_fresh_body_rate_there_is_nothing_to_prepare(driver: ReleaseServiceDriver) -> None:
    driver.armed()
    with pytest.raises(ConflictError, match=r"command\.empty"):
        driver.prepare()
    reported(driver)
    driver.rows(2)
    # a record without rates is newer, and does not hide the one that has them
    reported(driver, None)
    dry = driver.service.prepare(SC, "ann", CommandRequest("look"), dry_run=True)
    assert dry.computed is not None
    assert dry.computed.inhibitions == ()
    driver.rows(3)
    dry = driver.service.prepare(SC, "ann", CommandRequest("look"), dry_run=True)
    assert dry.computed is not None
    assert (dry.computed.inhibitions, dry.schedule) == (("no_body_rate",), ())


def test_a_standing_authorisation_is_never_asked_for_more_than_the_envelope(driver: ReleaseServiceDriver) -> None:
    driver.engaged()
    reported(driver, Axes(2e-3, 3e-3, -W0_DEG_S + 2e-3))
    driver.rows(1)
    assert driver.state == "ENGAGED"
    assert len(driver.released) == 1
    assert driver.released[0][1].is_automatic
    assert driver.released[0][1].computed.saturated
