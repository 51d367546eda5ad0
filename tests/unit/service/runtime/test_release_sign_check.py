"""A sign check on the service: legs are confirmed and reported one by one, and the powers decide."""

import numpy as np
import pytest
from release_service_driver import GOOD, US, ReleaseServiceDriver
from release_storage import SC
from sign_world import payload

from service.core.estimation.filtering.filter_model import pattern_change
from service.errors import ConflictError, InvalidInputError
from service.pipeline.control.release.command_states import CommandState
from service.pipeline.control.release.events import OrderKind
from service.pipeline.control.release.interlock_conditions import ReleaseSettings
from service.pipeline.estimation.method import CommandEvidence
from service.records.inputs import TelemetryRecord
from service.records.operations.release import Purpose
from service.runtime.control.sign_check_rows import turned_deg

#: in the order yaw, roll, pitch
INERTIA = np.diag([2600.0, 2600.0, 1400.0])
#: x roll, y pitch, z yaw of each wheel from yaw, roll, pitch
BODY = [1, 2, 0]


class AnsweringCraft:
    """Answers released schedules with a sign, in powers and in the momentum of its wheels."""

    def __init__(self, driver: ReleaseServiceDriver, sign: int, seed: int = 5) -> None:
        self.driver, self.sign = driver, sign
        self.model, self.rng = payload(seed), np.random.default_rng(seed)
        self.level = 0.09 * self.rng.normal(size=self.model.carriers)
        self.schedules: list = []
        self.greatest_deg = 0.0

    def evidence(self) -> CommandEvidence:
        """Return the powers of the present minute."""
        keep = np.exp(-60.0 / 1200.0)
        self.level = keep * self.level + 0.09 * np.sqrt(1.0 - keep**2) * self.rng.normal(size=self.model.carriers)
        turn = self.sign * turned_deg(self.schedules, np.array([self.driver.clock.now]), INERTIA, has_coupling=True)[0]
        self.greatest_deg = max(self.greatest_deg, float(np.abs(turn).max()))
        powers = pattern_change(self.model, turn).deviation_db + self.level + 0.4
        return CommandEvidence(self.model, powers + 0.155 * self.rng.normal(size=self.model.carriers), 0.0, None)

    def telemetry(self) -> None:
        """Tell the momentum of the wheels."""
        impulse = np.zeros(3)
        for pulse in (pulse for schedule in self.schedules for pulse in schedule):
            since_s = np.clip((self.driver.clock.now - pulse.start_us) / US, 0.0, pulse.duration_s)
            impulse -= self.sign * np.array(pulse.torque_n_m) * since_s
        reported = 1.0 + impulse[BODY] + 0.0005 * self.rng.normal(size=3)
        self.driver.archive.telemetry.append(
            TelemetryRecord(self.driver.clock.now, wheel_momentum_n_m_s=tuple(reported))
        )

    def minute(self, *, confirms: bool = True) -> None:
        """Pass a minute: persons confirm what waits, the centre reports what is over."""
        driver = self.driver
        for view in list(driver.releases.views.values()):
            if view.state == "PREPARED" and confirms:
                driver.confirm(view)
                self.schedules.append(view.schedule)
            elif view.state == "RELEASED" and view.stop_us < driver.clock.now:
                driver.report(view.counter)
        self.telemetry()
        driver.rows(1, lag_s=0.0, evidence=self.evidence())

    def fly(self, minutes: int) -> None:
        """Pass minutes until the check is over."""
        for _ in range(minutes):
            if self.driver.view.sign_check.state != "running":
                return
            self.minute()


def ready(sign: int = 1, seed: int = 5, settings: ReleaseSettings | None = None) -> AnsweringCraft:
    driver = ReleaseServiceDriver(settings)
    record = AnsweringCraft(driver, sign, seed)
    for _ in range(12):
        driver.rows(1, lag_s=0.0, evidence=record.evidence())
    driver.order(OrderKind.ARM)
    return record


@pytest.mark.parametrize("axis", ["roll", "pitch"])
def test_a_right_sign_is_proven_and_engaging_becomes_possible(axis):
    record = ready()
    driver = record.driver
    begun_us = driver.clock.now
    check = driver.service.sign_check(SC, axis, "ann").sign_check
    assert (check.state, check.axis, check.legs, check.legs_done) == ("running", axis, 4, 0)
    with pytest.raises(ConflictError, match=r"sign_check\.running"):
        driver.service.sign_check(SC, axis, "ann")
    record.fly(60)
    view = driver.view
    assert view.sign_check.state == "plus", view.sign_check
    assert view.proven_axes == (axis,)
    assert driver.clock.now - begun_us <= (45 + 10) * 60 * US
    assert driver.releases.released == [], "the filter was told of the torque"
    assert {command.purpose for command in driver.releases.views.values()} == {Purpose.SIGN_CHECK}
    assert record.greatest_deg < 0.1
    driver.rows(1)
    if axis == "roll":
        with pytest.raises(ConflictError, match=r"interlock\.sign_unproven"):
            driver.engage("ann")


@pytest.mark.parametrize(("sign", "word"), [(-1, "minus"), (0, "nothing")])
@pytest.mark.parametrize("axis", ["roll", "pitch"])
def test_a_wrong_sign_or_none_trips_before_a_tenth_of_a_degree_is_lost(axis, sign, word):
    record = ready(sign)
    record.driver.service.sign_check(SC, axis, "ann")
    record.fly(60)
    view = record.driver.view
    assert (view.sign_check.state, view.trips) == (word, ("response_missed",))
    assert record.greatest_deg < 0.1
    assert view.proven_axes == ()


def test_yaw_needs_powers_wheels_and_three_hours():
    record = ready()
    driver = record.driver
    begun_us = driver.clock.now
    driver.service.sign_check(SC, "yaw", "ann")
    record.fly(330)
    view = driver.view
    assert (view.sign_check.state, view.sign_check.wheels) == ("plus", "plus"), view.sign_check
    assert driver.clock.now - begun_us >= 3 * 3600 * US
    assert driver.releases.released == []


def test_yaw_without_telemetry_stays_open_and_is_not_engaged():
    record = ready(settings=ReleaseSettings(yaw_sign_check_s=6000.0, yaw_sign_least_s=3600.0))
    record.telemetry = lambda: None
    record.driver.service.sign_check(SC, "yaw", "ann")
    record.fly(130)
    view = record.driver.view
    assert (view.sign_check.state, view.proven_axes, view.trips) == ("open", (), ())
    assert "yaw_sign" in [reason.code for reason in view.reasons]


def test_legs_that_nobody_confirms_are_prepared_again_until_the_time_is_over():
    record = ready()
    driver = record.driver
    driver.service.sign_check(SC, "roll", "ann")
    for _ in range(56):
        record.minute(confirms=False)
    assert driver.view.sign_check.state == "open"
    lives = [command.state for command in driver.releases.views.values()]
    assert set(lives) == {"EXPIRED", "CANCELLED"} or set(lives) == {"EXPIRED"}
    assert len(lives) > 5


def test_a_restart_interrupts_a_check_and_a_lost_leg_is_flown_again():
    record = ready()
    driver = record.driver
    driver.service.sign_check(SC, "roll", "ann")
    first = driver.releases.views[1]
    driver.confirm(first)
    driver.report(1, "failed")
    assert driver.releases.views[2].purpose is Purpose.SIGN_CHECK
    driver.restart()
    driver.rows(1)
    check = driver.view.sign_check
    assert (check.state, check.legs_done) == ("interrupted", 0)
    assert driver.view.proven_axes == ()


def test_a_check_needs_an_axis_rows_and_a_state_in_which_commands_may_go():
    driver = ReleaseServiceDriver().armed()
    with pytest.raises(InvalidInputError, match=r"sign_check\.axis"):
        driver.service.sign_check(SC, "nick", "ann")
    with pytest.raises(ConflictError, match=r"sign_check\.no_rows"):
        driver.service.sign_check(SC, "roll", "ann")
    record = ready()
    record.driver.order(OrderKind.DISENGAGE)
    with pytest.raises(ConflictError, match=r"interlock\.not_armed"):
        record.driver.service.sign_check(SC, "roll", "ann")
    assert record.driver.view.sign_check is None


def test_the_turn_of_its_own_check_does_not_stop_it():
    record = ready()
    driver = record.driver
    moving = {"inhibitions": ("unannounced_motion",), "control_allowed": False}
    driver.service.sign_check(SC, "roll", "ann")
    driver.rows(1, lag_s=0.0, evidence=record.evidence(), **moving)
    assert driver.state == "ARMED"
    driver.service.cancel(SC, 1, "ann")
    driver.order(OrderKind.STOP)
    driver.rows(1, lag_s=0.0, evidence=record.evidence())
    assert driver.view.sign_check.state == "interrupted"
    assert GOOD.inhibitions == ()
    assert driver.service._release(SC).state.commands[0].state in (CommandState.CANCELLED, CommandState.REJECTED)
