"""Release: orders reach the interlock, everything is stored before it holds, a restart sends nothing again."""

import math
from dataclasses import replace

import pytest
from release_service_driver import GOOD, MINUTE_US, START_US, US, ReleaseServiceDriver
from release_storage import CRAFT, SC

from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S
from service.core.control.slew_schedule import Envelope
from service.errors import ConflictError, ForbiddenError, GoneError, InvalidInputError, NotFoundError, StorageError
from service.pipeline.control.release.events import OrderKind
from service.pipeline.estimation.method import CommandEvidence
from service.records.catalogue import ControlLaw, ControlMode, GyroOrbitantGains, Onboard, Release
from service.records.inputs import Operation, TelemetryRecord
from service.records.levels.attitude import Axes, Disturbance, ReportedCommand
from service.records.operations.release import CommandRequest, InterlockHold, ProductForm
from service.runtime.control.release_context import interlock_inputs, read_facts


@pytest.fixture
def driver():
    return ReleaseServiceDriver()


def test_before_anything_nothing_may_go_and_it_says_why(driver):
    view = driver.view
    assert (view.state, view.release, view.mode, view.is_armed) == ("INHIBITED", "two_step", "ground", False)
    assert driver.codes == ("estimate_old", "yaw_sign", "not_armed")
    assert view.envelope == Envelope()
    with pytest.raises(ConflictError, match=r"interlock\.inhibited"):
        driver.order(OrderKind.ARM)
    with pytest.raises(ConflictError, match=r"command\.no_estimate"):
        driver.prepare()
    with pytest.raises(NotFoundError, match=r"spacecraft\.unknown"):
        driver.service.control("nobody")


def test_ten_good_minutes_arm_and_two_persons_release(driver):
    driver.armed()
    command = driver.prepare()
    assert (command.counter, command.state, command.prepared_by) == (1, "PREPARED", "ann")
    assert all(check.is_ok for check in command.checks)
    assert command.start_us == driver.clock.now + 330 * US
    assert command.impulse_n_m_s.yaw == 0.0
    for by, is_approver in (("ann", True), ("bob", False)):
        with pytest.raises(ForbiddenError, match=r"command\.second_person"):
            driver.confirm(command, by, is_approver=is_approver)
    with pytest.raises(ConflictError, match=r"command\.digest"):
        driver.confirm(command, digest="0" * 64)
    released = driver.confirm(command)
    assert (released.state, released.confirmed_by, released.released_us) == ("RELEASED", "bob", driver.clock.now)
    assert driver.releases.released[0].schedule == command.schedule
    assert driver.notified == [SC]
    product = driver.releases.product(SC, ProductForm.TORQUES, 1)
    assert (product.counter, product.digest, product.schedule) == (1, command.digest, command.schedule)
    assert (product.is_simulated, product.valid_until_us) == (False, command.start_us)


@pytest.mark.parametrize(("is_held_up", "trips"), [(True, ()), (False, ("clock_jump",))])
def test_a_process_held_up_between_two_clocks_sees_no_jump_and_a_clock_that_is_set_trips(driver, is_held_up, trips):
    driver.armed()
    driver.clock.steady += US
    driver.clock.now += US
    if is_held_up:
        read_us, waits_us = driver.clock.system_us, iter([3 * US])

        def held_up_after_reading() -> int:
            present_us, wait_us = read_us(), next(waits_us, 0)
            driver.clock.now, driver.clock.steady = driver.clock.now + wait_us, driver.clock.steady + wait_us
            return present_us

        driver.clock.system_us = held_up_after_reading
    else:
        driver.clock.now += 3 * US
    assert tuple(driver.service.control(SC).trips) == trips


def test_a_dry_run_tells_failing_checks_and_stores_nothing(driver):
    driver.rows(2)
    saves = driver.releases.saves
    reported = driver.service.prepare(SC, "ann", CommandRequest("look"), dry_run=True)
    assert (reported.is_dry_run, reported.counter, driver.releases.views) == (True, 1, {})
    assert [check.name for check in reported.checks if not check.is_ok] == ["interlock"]
    assert driver.releases.saves == saves


def test_a_report_makes_it_known_and_the_next_command_may_go(driver):
    driver.armed()
    sent = driver.sent()
    driver.rows(1)
    with pytest.raises(ConflictError, match=r"command\.unreported"):
        driver.prepare()
    assert driver.report(1, "sent").state == "SENT"
    assert driver.report(1, executed_from_us=sent.start_us).state == "EXECUTED"
    assert driver.releases.reported[-1] == ReportedCommand(1, driver.clock.now, sent.schedule)
    reported = len(driver.releases.reported)
    driver.report(1, executed_from_us=sent.start_us)
    with pytest.raises(ConflictError, match=r"command\.state"):
        driver.report(1, "failed")
    assert len(driver.releases.reported) == reported
    assert driver.prepare().counter == 2


@pytest.mark.parametrize(("turn", "executed"), [("failed", ()), ("executed", None)])
def test_what_was_not_carried_out_is_told_as_nothing(driver, turn, executed):
    driver.armed()
    sent = driver.sent()
    report = driver.report(1, turn)
    assert report.executed == (sent.schedule if executed is None else executed)
    assert report.reported_by == "centre"


def test_reports_of_other_commands_and_other_times_are_refused(driver):
    driver.armed()
    driver.sent()
    for counter in (0, 2, 99):
        with pytest.raises(NotFoundError, match=r"command\.unknown"):
            driver.report(counter)
    for at_us in (START_US - 3600 * US, driver.clock.now + 3600 * US):
        with pytest.raises(InvalidInputError, match=r"report\.time"):
            driver.report(1, at_us=at_us)
    with pytest.raises(InvalidInputError, match=r"report\.interval"):
        driver.report(1, executed_from_us=10, executed_until_us=5)
    driver.report(1)
    driver.rows(70)
    with pytest.raises(ConflictError, match=r"command\.state"):
        driver.report(1, "failed")


def test_what_waits_too_long_expires_and_what_is_cancelled_is_over(driver):
    driver.armed()
    first = driver.prepare()
    with pytest.raises(ConflictError, match=r"command\.open"):
        driver.prepare()
    driver.rows(4)
    assert driver.service.command(SC, 1).state == "EXPIRED"
    with pytest.raises(GoneError, match=r"command\.expired"):
        driver.confirm(first)
    second = driver.prepare()
    assert driver.service.cancel(SC, 2, "ann").state == "CANCELLED"
    with pytest.raises(ConflictError, match=r"command\.state"):
        driver.confirm(second)


@pytest.mark.parametrize(
    ("wanted", "error", "code"),
    [
        ({"duration_s": 0.5}, ConflictError, "command.empty"),
        ({"duration_s": 9000.0}, InvalidInputError, "command.wish"),
        ({"start_us": 5}, InvalidInputError, "command.wish"),
        ({"start_us": 1 << 61}, InvalidInputError, "command.wish"),
        ({"max_torque_n_m": 1e-9}, ConflictError, "command.empty"),
        ({"attitude_epoch_us": 5}, ConflictError, "command.estimate_stale"),
        ({"attitude_epoch_us": 1 << 61}, ConflictError, "command.estimate_stale"),
    ],
)
def test_wishes_that_cannot_be_met_are_refused(driver, wanted, error, code):
    driver.armed()
    with pytest.raises(error, match=code.replace(".", r"\.")):
        driver.prepare(**wanted)
    assert driver.releases.views == {}


def test_engaging_needs_signs_two_persons_and_an_end(driver):
    driver.rows(12)
    driver.order(OrderKind.ARM)
    with pytest.raises(ConflictError, match=r"interlock\.sign_unproven"):
        driver.engage("ann")
    driver.prove("roll", "pitch")
    with pytest.raises(InvalidInputError, match=r"interlock\.authorisation"):
        driver.engage("ann", hours=13.0)
    with pytest.raises(InvalidInputError, match=r"envelope\.wider"):
        driver.service.engage(
            SC, "ann", is_approver=True, until_us=driver.clock.now + US, envelope=Envelope(impulse_n_m_s=0.03)
        )
    assert driver.engage("ann").requested_by == "ann"
    with pytest.raises(ForbiddenError, match=r"interlock\.second_person"):
        driver.engage("bob", is_approver=False)
    view = driver.engage("bob")
    assert (view.state, view.authorised_by) == ("ENGAGED", ("ann", "bob"))


def test_engaged_the_law_sends_once_a_period_while_nothing_waits_for_a_report(driver):
    driver.engaged()
    driver.rows(1)
    (command,) = driver.releases.views.values()
    assert (command.state, command.is_automatic, command.confirmed_by) == ("RELEASED", True, "authorisation")
    assert command.start_us == driver.clock.now + 150 * US
    assert [event.action for event in driver.archive.audit_events].count("release_torque") == 1
    driver.rows(20)
    assert len(driver.releases.views) == 1
    driver.report(1)
    driver.rows(1)
    assert len(driver.releases.views) == 2
    driver.report(2)
    driver.rows(14)
    assert len(driver.releases.views) == 2
    driver.rows(1)
    assert len(driver.releases.views) == 3


def test_in_rain_the_authorisation_goes_on_for_what_balances_the_known_torque(driver):
    epoch_us = driver.clock.now
    zero = Axes(0.0, 0.0, 0.0)
    driver.disturbance = Disturbance(epoch_us, 86_400.0, Axes(0.0, 1e-6, 0.0), zero, zero, Axes(1e-7, 1e-7, 1e-7))
    driver.engaged()
    rain = {"downlink_fade": True, "inhibitions": ("downlink_fade",), "control_allowed": False}
    rain["control_allowed_axes"] = (False, False, False)
    driver.rows(1, **rain)
    assert (driver.state, driver.verdict.is_allowed, driver.verdict.state) == ("BALANCE", False, "BALANCE")
    (command,) = driver.releases.views.values()
    assert (command.purpose, command.is_automatic, command.checks) == ("balance", True, ())
    # roll is 0.06 deg off, and only the torque about it is answered
    assert command.impulse_n_m_s.roll < 0.0
    assert (command.gross_impulse_n_m_s.yaw, command.gross_impulse_n_m_s.pitch) == (0.0, 0.0)
    for _ in range(179):
        driver.rows(1, **rain)
        for each in [view for view in driver.releases.views.values() if view.state == "RELEASED"]:
            driver.report(each.counter)
    assert (driver.state, len(driver.releases.views)) == ("BALANCE", 12)
    driver.rows(1, **rain)
    assert driver.state == "INHIBITED"
    driver.rows(11)
    assert driver.state == "ENGAGED"


def test_a_stop_ends_balance(driver):
    driver.engaged()
    driver.rows(1, inhibitions=("chain_step",), control_allowed=False)
    assert driver.state == "BALANCE"
    driver.order(OrderKind.STOP)
    assert driver.state == "TRIPPED"


def test_a_late_report_inhibits_and_the_report_brings_control_back(driver):
    driver.armed()
    sent = driver.sent()
    driver.rows((sent.stop_us - driver.clock.now) // MINUTE_US + 11)
    assert (driver.state, "report_late" in driver.codes) == ("INHIBITED", True)
    driver.report(1)
    driver.rows(11)
    assert driver.state == "ARMED"


@pytest.mark.parametrize("moment", ["before", "after"])
def test_killed_while_a_release_is_stored_it_is_sent_once_or_never(driver, moment):
    driver.armed()
    command = driver.prepare()
    driver.killed_at(moment, lambda: driver.confirm(command))
    assert len(driver.releases.released) == (1 if moment == "after" else 0)
    with pytest.raises((ConflictError, GoneError)):
        driver.confirm(command)
    if moment == "after":
        assert driver.view.unreported_commands == (1,)
        assert driver.report(1).state == "EXECUTED"
        assert isinstance(driver.releases.reported[-1], ReportedCommand)
    assert len(driver.releases.released) == (1 if moment == "after" else 0)
    driver.rows(12)
    assert driver.state == "ARMED"


def test_while_the_archive_is_away_nothing_holds(driver):
    driver.armed()
    command = driver.prepare()
    driver.releases.is_away = True
    with pytest.raises(StorageError):
        driver.confirm(command)
    assert driver.view.unreported_commands == ()
    driver.releases.is_away = False
    assert driver.confirm(command).state == "RELEASED"


def test_after_a_start_documents_are_compared_before_the_first_row_is_stored(driver):
    driver.armed()
    driver.archive.damaged_documents = ("calibration 7",)
    driver.restart()
    with driver.service.steady(SC) as is_withheld:
        assert is_withheld
    (hold,) = [each for each in driver.releases.reported if isinstance(each, InterlockHold)]
    assert (hold.is_withheld, hold.reasons[0]) == (True, "document_corrupt")
    with pytest.raises(ConflictError, match=r"interlock\.trip_stands"):
        driver.order(OrderKind.RESET)
    driver.tell(damaged_documents=())
    driver.rows(1)
    assert driver.order(OrderKind.RESET).state == "INHIBITED"


def test_of_two_services_on_one_archive_one_releases_and_control_trips(driver):
    driver.armed()
    command = driver.prepare()
    first = driver.service
    driver.start()
    second, driver.service = driver.service, first
    second.order(SC, OrderKind.STOP, "bob")
    with pytest.raises(ConflictError, match=r"command\.state"):
        driver.confirm(command)
    assert driver.releases.released == []
    assert "lease" in driver.codes
    with pytest.raises(ConflictError, match=r"interlock\.trip_stands"):
        driver.order(OrderKind.RESET)
    driver.rows(12)
    assert driver.order(OrderKind.RESET).state == "INHIBITED"


def test_a_service_that_does_not_lead_tells_what_is_stored_and_takes_no_orders(driver):
    driver.armed()
    turns = [0]
    driver._arguments = {"turn": lambda _: turns[0]}
    driver.start()
    assert driver.state == "ARMED"
    for order in (lambda: driver.order(OrderKind.STOP), driver.prepare, lambda: driver.report(1)):
        with pytest.raises(StorageError, match=r"lease\.elsewhere: craft is led by host-1:7"):
            order()
    driver.service.tick()
    turns[0] = 1
    assert driver.state == "INHIBITED"
    driver.rows(12)
    assert driver.state == "ARMED"


def test_time_passes_for_a_spacecraft_when_the_release_of_another_one_cannot_be_read(driver, caplog):
    driver.armed()
    driver.prepare()
    driver.archive.catalogue.all_spacecraft = lambda: (replace(CRAFT, id="unknown-1"), driver.archive.record)
    driver.pass_time(driver.settings.prepared_s)
    driver.service.tick()
    assert driver.releases.command(SC, 1).state == "EXPIRED"
    assert "release loop failed for unknown-1: spacecraft.unknown" in caplog.text


@pytest.mark.parametrize("momentum_n_m_s", [17.0, -17.0])
def test_a_trip_is_told_to_the_journal_and_its_reset_as_well(driver, momentum_n_m_s):
    driver.armed()
    driver.prepare()
    driver.momentum(momentum_n_m_s)
    driver.rows(1)
    assert driver.service.command(SC, 1).state == "REJECTED"
    hold = driver.releases.reported[-1]
    assert isinstance(hold, InterlockHold)
    assert (hold.state, hold.is_withheld, "momentum" in hold.reasons) == ("TRIPPED", True, True)
    driver.momentum(1.0)
    driver.order(OrderKind.RESET)
    assert driver.view.is_withheld
    driver.rows(12)
    assert driver.releases.reported[-1].is_withheld is False
    actions = [event.action for event in driver.archive.audit_events]
    assert actions == ["interlock_armed", "interlock_tripped", "interlock_inhibited"]


def test_one_record_of_a_momentum_trips_nothing_and_the_second_does(driver):
    """Before, one wild record of 1e6 N m s took control away until a person reset it."""
    driver.armed()
    driver.momentum(1.0)
    driver.rows(1)
    driver.momentum(1e6, records=1)
    driver.rows(1)
    assert driver.state != "TRIPPED"
    assert "momentum" not in driver.codes
    driver.momentum(1.0, records=1)
    driver.rows(1)
    driver.momentum(17.0)
    assert (driver.state, "momentum" in driver.codes) == ("TRIPPED", True)


def test_of_slow_telemetry_the_record_of_before_counts(driver):
    driver.armed()
    driver.momentum(17.0, records=1)
    driver.rows(25)
    driver.momentum(17.0, records=1)
    assert (driver.state, "momentum" in driver.codes) == ("TRIPPED", True)


def test_a_momentum_that_is_no_number_trips_and_is_the_same_fact_at_the_next_look(driver):
    driver.armed()
    driver.momentum(math.nan)
    assert (driver.state, "momentum" in driver.codes) == ("TRIPPED", True)
    facts = read_facts(driver.archive, SC, driver.clock.now)
    first, second = (interlock_inputs(facts, driver.clock.now, lease_holders=1, is_disagreeing=False) for _ in range(2))
    assert first == second


def test_under_automatic_release_the_interlock_watches_and_a_trip_withholds():
    driver = ReleaseServiceDriver()
    driver.archive.change_spacecraft(release=Release.AUTOMATIC)
    driver.rows(2)
    assert driver.verdict.state == "ENGAGED"
    for order in (lambda: driver.order(OrderKind.ARM), driver.prepare, lambda: driver.engage("ann")):
        with pytest.raises(ConflictError, match=r"release\.automatic"):
            order()
    view = driver.order(OrderKind.STOP)
    assert (view.state, view.is_withheld, view.trips) == ("TRIPPED", True, ("stop",))
    assert driver.releases.reported[-1].is_withheld
    assert driver.order(OrderKind.RESET).is_withheld
    driver.rows(12)
    assert driver.releases.reported[-1].is_withheld is False


@pytest.mark.parametrize(
    "changes", [{"mode": ControlMode.ONBOARD}, {"mode": ControlMode.OFF}, {"onboard": Onboard(fast_loop=True)}]
)
def test_modes_without_torques_from_the_ground_release_none(driver, changes):
    driver.archive.change_spacecraft(**changes)
    driver.rows(12)
    for order in (lambda: driver.order(OrderKind.ARM), driver.prepare, lambda: driver.engage("ann")):
        with pytest.raises(ConflictError, match=r"control\.mode"):
            order()


def test_mode_onboard_gets_angles_while_they_are_fit_for_use(driver):
    with pytest.raises(ConflictError, match=r"control\.mode"):
        driver.service.attitude_uplink(SC)
    driver.archive.change_spacecraft(mode=ControlMode.ONBOARD)
    with pytest.raises(NotFoundError, match=r"uplink\.unknown"):
        driver.service.attitude_uplink(SC)
    driver.rows(3)
    product = driver.service.attitude_uplink(SC)
    assert (product.form, product.counter, product.attitude_deg) == (ProductForm.ATTITUDE, 3, GOOD.attitude_deg)
    driver.rows(3, control_allowed=False, inhibitions=("downlink_fade",))
    assert driver.service.attitude_uplink(SC) == product
    driver.rows(1, downlink_fade=True)
    with pytest.raises(GoneError, match=r"uplink\.expired"):
        driver.service.attitude_uplink(SC)


def test_under_the_data_clock_only_simulated_craft_get_commands():
    driver = ReleaseServiceDriver(is_data_service=True)
    driver.rows(12)
    orders = (
        lambda: driver.order(OrderKind.ARM),
        driver.prepare,
        lambda: driver.engage("ann"),
        lambda: driver.service.sign_check(SC, "roll", "ann"),
    )
    for order in orders:
        with pytest.raises(ConflictError, match=r"interlock\.simulated"):
            order()
    driver = ReleaseServiceDriver(is_data_service=True)
    driver.archive.change_spacecraft(simulated=True)
    driver.clock.is_of_data = True
    driver.armed()
    assert driver.sent().is_simulated
    assert driver.releases.product(SC, ProductForm.TORQUES, 1).is_simulated


def test_facts_of_the_archive_reach_the_interlock(driver):
    driver.armed()
    driver.tell(operations=[Operation(1, "station_keeping", driver.clock.now, None, inhibit_control=True)])
    assert "operation" in driver.codes
    driver.tell(operations=[Operation(1, "station_keeping", 5, driver.clock.now - US)])
    assert "ephemeris" in driver.codes
    driver.tell(ephemeris_received_us=driver.clock.now)
    assert "ephemeris" not in driver.codes
    driver.tell(calibration_id=8)
    assert driver.view.trips == ("configuration",)


def test_other_control_settings_trip_and_keep_the_proven_signs_other_wheels_do_not(driver):
    driver.armed()
    driver.archive.change_spacecraft(damping=0.7)
    driver.tell()
    assert (driver.view.trips, driver.view.proven_axes) == (("configuration",), ("roll", "pitch"))
    driver.archive.change_spacecraft(wheels=replace(driver.archive.record.wheels, torque_quantum_n_m=0.001))
    driver.tell()
    assert driver.view.proven_axes == ()


def test_a_release_that_was_stored_without_an_answer_is_not_sent_again(driver):
    driver.armed()
    command = driver.prepare()
    driver.releases.is_answer_lost = True
    with pytest.raises(StorageError):
        driver.confirm(command)
    assert len(driver.releases.released) == 1
    with pytest.raises(ConflictError, match=r"command\.state"):
        driver.confirm(command)
    assert (len(driver.releases.released), driver.state) == (1, "INHIBITED")
    assert driver.view.trips == ()


def test_a_command_that_did_nothing_trips_when_it_is_reported_executed(driver):
    evidence = CommandEvidence(None, None, 0.0, 12.0)
    driver.armed()
    driver.sent()
    driver.row = replace(GOOD, epoch_us=driver.clock.now)
    driver.on_rows(evidence=evidence)
    assert driver.state == "ARMED"
    driver.report(1)
    assert driver.view.trips == ("response_missed",)


def test_from_beyond_the_range_only_an_approver_brings_it_back_and_in_small_steps(driver):
    driver.engaged()
    far = Axes(0.0, 0.45, 0.0)
    driver.rows(1, attitude_deg=far, inhibitions=("beyond_validity",), control_allowed=False)
    assert driver.state == "RECOVERY"
    command = driver.sent()
    assert -0.2 <= command.peak_angle_deg.roll < -0.1


def reason_codes(driver):
    return {reason.code for reason in driver.view.reasons}


def test_beyond_the_model_only_an_angle_whose_sign_is_certain_is_led_back(driver):
    driver.engaged()
    doubted = {
        "attitude_deg": Axes(1.2, -3.1, 0.2),
        "inhibitions": ("beyond_validity", "protection_level"),
        "control_allowed": False,
        "control_allowed_axes": (False, False, False),
    }
    driver.rows(1, protection_deg=Axes(2.0, 1.5, 0.9), **doubted)
    assert driver.state == "RECOVERY"
    assert reason_codes(driver) == {"yaw_sign", "beyond_validity", "protection_level"}
    command = driver.sent()
    # the level of pitch exceeds its angle, that of yaw too
    assert (command.peak_angle_deg.yaw, command.peak_angle_deg.pitch) == (0.0, 0.0)
    assert 0.1 < command.peak_angle_deg.roll <= 0.2
    driver.rows(1, protection_deg=Axes(0.9, 1.5, 0.3), **doubted)
    assert driver.state == "RECOVERY"
    driver.rows(1, protection_deg=Axes(0.9, 3.5, 0.3), **doubted)
    assert driver.state == "INHIBITED"
    assert {"estimator", "hand_over"} <= reason_codes(driver)
    driver.rows(
        1, protection_deg=Axes(0.9, 0.5, 0.3), **doubted | {"inhibitions": ("beyond_validity", "downlink_fade")}
    )
    assert {"estimator", "hand_over"} & reason_codes(driver) == {"estimator"}


def test_idle_rows_cost_no_write(driver):
    driver.rows(5)
    saves = driver.releases.saves
    driver.rows(100)
    assert driver.releases.saves == saves


W0_DEG_S = math.degrees(GEOSTATIONARY_RATE_RAD_S)
GAINS = GyroOrbitantGains(9.9e-4, 2.0, 5.3e-4, 1.1, 3.1e-4, 2.0)
#: a tenth of a degree of yaw, told by the roll rate
RATE = Axes(0.0, -W0_DEG_S * math.radians(0.1), -W0_DEG_S)


@pytest.fixture
def gyro_driver() -> ReleaseServiceDriver:
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


def test_a_command_of_the_law_is_prepared_confirmed_and_released(gyro_driver: ReleaseServiceDriver) -> None:
    gyro_driver.armed()
    gyro_driver.prove("yaw")
    reported(gyro_driver)
    command = gyro_driver.prepare()
    assert all(check.is_ok for check in command.checks)
    assert command.stop_us - command.start_us <= 900_000_000
    # the roll of the row is 0.06 deg, its yaw 0.02; pitch would fill no pulse
    impulse = command.impulse_n_m_s
    assert impulse.yaw < 0.0
    assert impulse.roll < 0.0
    assert impulse.pitch == 0.0
    assert gyro_driver.confirm(command).state == "RELEASED"


def test_without_a_fresh_body_rate_there_is_nothing_to_prepare(gyro_driver: ReleaseServiceDriver) -> None:
    gyro_driver.armed()
    with pytest.raises(ConflictError, match=r"command\.empty"):
        gyro_driver.prepare()
    reported(gyro_driver)
    gyro_driver.rows(2)
    # a record without rates is newer, and does not hide the one that has them
    reported(gyro_driver, None)
    dry = gyro_driver.service.prepare(SC, "ann", CommandRequest("look"), dry_run=True)
    assert dry.computed is not None
    assert dry.computed.inhibitions == ()
    gyro_driver.rows(3)
    dry = gyro_driver.service.prepare(SC, "ann", CommandRequest("look"), dry_run=True)
    assert dry.computed is not None
    assert (dry.computed.inhibitions, dry.schedule) == (("no_body_rate",), ())


def test_a_standing_authorisation_is_never_asked_for_more_than_the_envelope(gyro_driver: ReleaseServiceDriver) -> None:
    gyro_driver.engaged()
    reported(gyro_driver, Axes(2e-3, 3e-3, -W0_DEG_S + 2e-3))
    gyro_driver.rows(1)
    assert gyro_driver.state == "ENGAGED"
    assert len(gyro_driver.released) == 1
    assert gyro_driver.released[0][1].is_automatic
    assert gyro_driver.released[0][1].computed.saturated
