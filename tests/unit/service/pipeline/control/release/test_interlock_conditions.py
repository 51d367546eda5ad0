"""The interlock: its conditions, the checks of signs and the document of the state."""

import json
import math
from dataclasses import replace

import pytest
from release_driver import GOOD, INPUTS, MINUTE_US, START_US, US, ReleaseDriver, slew

from service.core.control.sign_check import SignState
from service.pipeline.control.release.advance import restored
from service.pipeline.control.release.command_states import CommandTransition
from service.pipeline.control.release.events import (
    Applied,
    BeginSignCheck,
    Cancel,
    Engage,
    InputsChanged,
    JournalEffect,
    OrderKind,
    Prepare,
    PrepareLeg,
    Refusal,
    ReleaseState,
    Report,
    ResponseJudged,
    SignJudged,
    UplinkEffect,
    document_of,
    state_of,
)
from service.pipeline.control.release.interlock_conditions import Condition, Consequence, interlock_row
from service.pipeline.control.release.sign_checks import is_leg_due, profile_of
from service.records.catalogue import Method
from service.records.levels.attitude import Axes, row_without_attitude
from service.records.operations.release import CommandState, Purpose, SignCheck, SignRatios

NAN = float("nan")


#: of whose torque nothing is known that may be balanced
BAD = replace(GOOD, balance_axes=(False, False, False))


def row(**change):
    return lambda driver: driver.rows(1, replace(BAD, **change))


def reported(**change):
    return lambda driver: driver.report(**change)


def after_a_gap(driver):
    driver.pass_time(200.0)
    driver.rows(1, lag_s=0.0)


def from_the_future(driver):
    for ahead_s in (80.0, 150.0, 220.0):
        driver.rows(1, lag_s=-ahead_s)


def bad_innovations(driver):
    driver.rows(31, replace(GOOD, is_innovation_in_band=False))


def another_mode(driver):
    driver.settings = replace(driver.settings, entry_modes="FORECAST, EARTH")
    driver.report(onboard_mode="SAFE")


def late_report(driver):
    driver.prepare()
    driver.confirm()
    driver.rows(40)


def clock_jump(driver):
    driver.jump_clock(2.5)
    driver.rows(1)


def too_much(driver):
    driver.rows(1, lag_s=0.0)
    driver.automatic(roll_deg=0.2)


def two_unreported(driver):
    driver.settings = replace(driver.settings, max_unreported=0)
    driver.prepare()
    driver.confirm()


def long_disagreement(driver):
    driver.report(is_disagreeing=True)
    driver.rows(16)


def engage(driver):
    driver.engage("ann")
    driver.engage("bob")


CASES = {
    Condition.ESTIMATE_OLD: [lambda driver: driver.tick(201.0), from_the_future],
    Condition.ESTIMATOR: [row(inhibitions=("chain_step",))],
    Condition.NOT_ALIGNED: [reported(is_aligned=False)],
    Condition.FADE: [row(is_fading=True)],
    Condition.REDUNDANCY: [row(redundancy=1)],
    Condition.GAP: [after_a_gap],
    Condition.OPERATION: [reported(has_inhibiting_operation=True)],
    Condition.EPHEMERIS: [
        reported(ephemeris_stop_us=None),
        reported(ephemeris_stop_us=START_US + 6 * 3600 * US),
        reported(burn_stop_us=START_US),
    ],
    Condition.INNOVATION: [bad_innovations],
    Condition.ONBOARD_MODE: [another_mode],
    Condition.REPORT_LATE: [late_report],
    Condition.HAND_OVER: [row(attitude_deg=Axes(0.0, 0.0, -2.01)), row(attitude_deg=Axes(0.0, NAN, 0.0))],
    Condition.CLOCK_JUMP: [clock_jump],
    Condition.MOMENTUM: [reported(momentum_share=0.81), reported(momentum_share=NAN)],
    Condition.RESPONSE_MISSED: [
        lambda driver: driver.send(ResponseJudged(driver.at, 9.1)),
        lambda driver: driver.send(ResponseJudged(driver.at, NAN)),
        lambda driver: driver.send(SignJudged(driver.at, "roll", SignState.MINUS)),
        lambda driver: driver.send(SignJudged(driver.at, "pitch", SignState.NOTHING)),
    ],
    Condition.ENVELOPE: [lambda driver: [engage(driver), too_much(driver)]],
    Condition.CONFIGURATION: [reported(calibration_id=8), reported(plan_id=4), reported(spacecraft_version=2)],
    Condition.UNREPORTED: [two_unreported],
    Condition.LEASE: [reported(lease_holders=2)],
    Condition.DOCUMENT_CORRUPT: [reported(damaged_documents=("calibration 3",))],
    Condition.STOP: [lambda driver: driver.order(OrderKind.STOP)],
    Condition.YAW_UNCERTAIN: [row(is_yaw_allowed=False)],
    Condition.YAW_SIGN: [lambda driver: driver.forget("yaw")],
    Condition.DISAGREEMENT: [long_disagreement],
}
FLAT = [(condition, act) for condition, acts in CASES.items() for act in acts]
STOPS = [(c, act) for c, act in FLAT if c.consequence in (Consequence.INHIBIT, Consequence.TRIP)]


@pytest.mark.parametrize(
    ("roll_deg", "ratio", "has_tripped"), [(0.39, 9.0, False), (0.41, 4.4, False), (0.41, 4.6, True)]
)
def test_beyond_the_range_what_the_filter_believes_is_enough_to_miss_a_response(roll_deg, ratio, has_tripped):
    """A flipped axis was led on by single commands that the filter took for reversed."""
    driver = ReleaseDriver().armed()
    row(attitude_deg=Axes(0.0, roll_deg, 0.0))(driver)
    driver.send(ResponseJudged(driver.at, ratio))
    assert (driver.name == "TRIPPED") is has_tripped


def test_every_condition_has_a_case():
    assert set(CASES) == set(Condition)


@pytest.mark.parametrize(("condition", "act"), STOPS, ids=lambda each: getattr(each, "word", ""))
def test_a_condition_alone_stops_every_release(condition, act):
    driver = ReleaseDriver().armed()
    act(driver)
    expected = "TRIPPED" if condition.consequence is Consequence.TRIP else "INHIBITED"
    assert driver.name == expected
    assert condition.word in driver.state.interlock.reasons
    refusal = driver.prepare(by="cas").refusal
    assert refusal.code in ("interlock.inhibited", "interlock.tripped")
    assert condition.word in refusal.detail


def test_a_row_at_its_limit_stops_nothing():
    driver = ReleaseDriver().armed()
    driver.rows(1, replace(GOOD, redundancy=2))
    assert driver.name == "ARMED"


@pytest.mark.parametrize("act", [row(is_fading=True), row(redundancy=0), after_a_gap, row(inhibitions=("late",))])
def test_an_inhibition_clears_itself_after_ten_good_minutes_and_no_sooner(act):
    driver = ReleaseDriver().engaged()
    act(driver)
    driver.rows(10)
    assert driver.name == "INHIBITED"
    assert driver.state.interlock.reasons == ("good_minutes",)
    driver.rows(1)
    assert driver.name == "ENGAGED"


def test_a_reason_within_the_ten_minutes_begins_them_anew():
    driver = ReleaseDriver().engaged()
    driver.rows(1, replace(BAD, is_fading=True))
    driver.rows(9)
    driver.rows(1, replace(BAD, is_fading=True))
    driver.rows(10)
    assert driver.name == "INHIBITED"


def test_silence_is_no_good_time():
    driver = ReleaseDriver().engaged()
    driver.rows(1, replace(BAD, is_fading=True))
    driver.rows(1)
    driver.pass_time(900.0)
    driver.rows(1)
    assert driver.name == "INHIBITED"


def test_innovations_may_be_outside_their_band_for_less_than_half_an_hour():
    driver = ReleaseDriver().armed()
    driver.rows(30, replace(GOOD, is_innovation_in_band=False))
    driver.rows(1)
    driver.rows(30, replace(GOOD, is_innovation_in_band=False))
    assert driver.name == "ARMED"


def test_trips_are_latched_until_reset_and_the_way_back_is_the_whole_one():
    driver = ReleaseDriver().engaged()
    driver.report(momentum_share=0.9)
    driver.report(momentum_share=0.2)
    driver.rows(120)
    assert driver.name == "TRIPPED"
    assert driver.order(OrderKind.ARM).refusal.code == "interlock.tripped"
    assert driver.order(OrderKind.RESET).refusal is None
    assert driver.order(OrderKind.ARM).refusal.code == "interlock.inhibited"
    driver.rows(11)
    assert driver.name == "INHIBITED"
    assert driver.state.interlock.authorisation is None
    assert driver.order(OrderKind.ARM).refusal is None


def test_a_trip_that_stands_cannot_be_reset():
    driver = ReleaseDriver().armed()
    driver.report(momentum_share=0.9)
    assert driver.order(OrderKind.RESET).refusal.code == "interlock.trip_stands"


def test_a_trip_rejects_what_waits():
    driver = ReleaseDriver().armed()
    driver.prepare()
    driver.order(OrderKind.STOP)
    assert driver.state.commands[-1].state == "REJECTED"


@pytest.mark.parametrize("act", [*CASES[Condition.YAW_UNCERTAIN], *CASES[Condition.YAW_SIGN]])
def test_yaw_is_withheld_while_roll_and_pitch_go_on(act):
    driver = ReleaseDriver().engaged()
    act(driver)
    assert driver.name == "ENGAGED"
    assert driver.automatic(roll_deg=0.0, yaw_deg=0.03).refusal.code == "interlock.yaw_withheld"
    assert driver.automatic(roll_deg=0.03).refusal is None


def test_disagreement_of_the_methods_is_an_alarm_only():
    driver = ReleaseDriver().engaged()
    long_disagreement(driver)
    assert driver.name == "ENGAGED"
    assert driver.alarms == ["disagreement"]


def test_beyond_the_range_automatic_release_is_off_and_stays_off():
    driver = ReleaseDriver().engaged()
    driver.rows(1, replace(GOOD, attitude_deg=Axes(0.0, 0.42, 0.0), inhibitions=("beyond_validity",)))
    assert driver.name == "RECOVERY"
    assert driver.automatic(roll_deg=-0.09, horizon_s=1200.0).refusal.code == "interlock.not_engaged"
    assert driver.prepare(roll_deg=-0.3, horizon_s=3600.0).refusal.code == "envelope.exceeded"
    assert driver.prepare(roll_deg=-0.09, horizon_s=1200.0).refusal is None
    assert driver.confirm().refusal is None
    driver.rows(1)
    assert driver.name == "ARMED"
    assert driver.state.interlock.authorisation is None


def test_beyond_the_range_while_inhibited_takes_the_authorisation_too():
    driver = ReleaseDriver().engaged()
    driver.rows(1, replace(BAD, attitude_deg=Axes(0.0, 0.42, 0.0), is_fading=True))
    driver.rows(12)
    assert driver.name == "ARMED"


def test_beyond_the_range_nothing_goes_unless_a_person_arms_after_ten_good_minutes():
    driver = ReleaseDriver()
    driver.send(InputsChanged(driver.at, INPUTS))
    beyond = replace(GOOD, attitude_deg=Axes(0.0, 0.45, 0.0))
    driver.rows(5, beyond)
    assert driver.order(OrderKind.ARM).refusal.code == "interlock.inhibited"
    driver.rows(10, beyond)
    assert (driver.name, driver.prepare().refusal.code) == ("INHIBITED", "interlock.not_armed")
    assert driver.order(OrderKind.ARM).refusal is None
    assert driver.name == "RECOVERY"


def test_a_new_spacecraft_version_forgets_the_signs():
    driver = ReleaseDriver().armed()
    driver.report(spacecraft_version=2)
    assert driver.state.interlock.proven_axes == ()


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"until_us": START_US}, "interlock.authorisation"),
        ({"until_us": START_US + 14 * 3600 * US}, "interlock.authorisation"),
        ({"wide": True}, "envelope.wider"),
    ],
)
def test_terms_that_are_not_allowed_are_refused(change, code):
    driver = ReleaseDriver().armed()
    wide = {"envelope": replace_envelope(driver, 0.3)} if change.pop("wide", False) else {}
    given = {"until_us": START_US + 3600 * US, "envelope": driver.settings.envelope, **change, **wide}
    assert driver.send(Engage(driver.at, "ann", is_approver=True, **given)).refusal.code == code


def replace_envelope(driver, angle_deg):
    return driver.settings.envelope._replace(angle_change_deg=angle_deg)


def test_one_person_is_not_enough_nor_are_two_who_want_different_things():
    driver = ReleaseDriver().armed()
    assert driver.engage("ann").refusal is None
    assert driver.engage("ann").refusal is None
    assert driver.name == "ARMED"
    assert driver.engage("bob", hours=5.0).refusal.code == "interlock.second_person"
    assert driver.engage("bob", is_approver=False).refusal.code == "interlock.second_person"
    driver.rows(11)
    # the first one asked too long ago: bob begins again
    assert driver.engage("bob").refusal is None
    assert driver.name == "ARMED"
    driver.engage("ann")
    assert driver.name == "ENGAGED"
    assert driver.state.interlock.authorisation.persons == ("bob", "ann")


def test_nobody_engages_an_axis_whose_sign_is_not_proven():
    driver = ReleaseDriver().armed()
    driver.forget("pitch")
    assert driver.engage("ann").refusal.code == "interlock.sign_unproven"


def test_the_authorisation_ends_by_itself():
    driver = ReleaseDriver().engaged()
    driver.rows(360)
    assert driver.name == "ARMED"
    assert driver.automatic().refusal.code == "interlock.not_engaged"


@pytest.mark.parametrize(
    ("state", "kind", "code"),
    [
        ("armed", OrderKind.ARM, "interlock.state"),
        ("armed", OrderKind.RESET, "interlock.state"),
        ("nothing", OrderKind.DISENGAGE, "interlock.not_armed"),
        ("nothing", OrderKind.ARM, "interlock.inhibited"),
    ],
)
def test_orders_that_mean_nothing_are_refused(state, kind, code):
    driver = ReleaseDriver()
    if state == "armed":
        driver.armed()
    assert driver.order(kind).refusal.code == code


def test_what_the_authorisation_sends_waits_for_its_report_like_any_other():
    driver = ReleaseDriver().engaged()
    assert driver.automatic(is_reported=False).refusal is None
    driver.rows(1)
    assert driver.automatic().refusal.code == "command.unreported"
    assert driver.send(Report(driver.at, 1, CommandTransition.EXECUTED)).refusal is None
    assert driver.automatic().refusal is None


def test_a_computed_command_that_counts_as_applied_trips_beyond_the_envelope_and_counts_for_the_hour():
    driver = ReleaseDriver().armed()
    _, effect = slew(0.0, 0.05, 0.0, 900.0)
    _, far = slew(0.0, 0.5, 0.0, 3600.0)
    times = int(0.1 / effect.gross_impulse_n_m_s[1])
    for _ in range(times):
        assert driver.send(Applied(driver.at, effect)).refusal is None
        driver.rows(1)
    assert driver.name == "ARMED"
    assert driver.prepare(roll_deg=0.05).refusal.code == "envelope.exceeded"
    driver.send(Applied(driver.at, effect))
    assert driver.name == "TRIPPED"
    driver = ReleaseDriver().armed()
    driver.send(Applied(driver.at, far))
    assert (driver.name, driver.state.interlock.trips[0].word) == ("TRIPPED", "envelope")


def test_a_sign_check_of_yaw_needs_no_proven_sign_and_every_other_reason_still_holds():
    driver = ReleaseDriver().armed()
    driver.forget("yaw")
    request = replace(driver.proposal(roll_deg=0.0, yaw_deg=0.03), purpose=Purpose.SIGN_CHECK)
    assert driver.send(Prepare(driver.at, "ann", replace(request, purpose=Purpose.CONTROL))).refusal is not None
    assert driver.send(Prepare(driver.at, "ann", request)).refusal is None
    driver.send(Cancel(driver.at, "ann", 1))
    driver.rows(1, replace(GOOD, is_yaw_allowed=False))
    late = replace(request, attitude_epoch_us=driver.row.epoch_us, start_us=driver.now_us + 600 * US)
    assert driver.send(Prepare(driver.at, "ann", late)).refusal.code == "interlock.yaw_withheld"


def test_a_row_from_the_future_is_not_believed():
    driver = ReleaseDriver().engaged()
    driver.rows(1, lag_s=-600.0)
    assert driver.name == "INHIBITED"
    assert driver.row.epoch_us - driver.now_us == 10 * MINUTE_US


def test_a_row_without_attitude_inhibits():
    stored = row_without_attitude(5_000_000, 5_100_000, 1, Method.ROBUST, ("no_fix",))
    facts = interlock_row(stored, None, 60.0, is_innovation_in_band=True)
    assert (facts.epoch_us, facts.period_s, facts.redundancy) == (5_000_000, 60.0, -3)
    assert facts.inhibitions == ("no_fix", "invalid")


@pytest.fixture
def driver():
    driver = ReleaseDriver().armed()
    driver.forget("roll")
    return driver


def leg(driver):
    return replace(driver.proposal(roll_deg=0.05), purpose=Purpose.SIGN_CHECK)


def begun(driver):
    step = driver.send(BeginSignCheck(driver.at, "ann", "roll", leg(driver)))
    assert step.refusal is None
    return driver.state.sign_check


def judged(driver, verdict):
    return driver.send(SignJudged(driver.at, "roll", verdict))


def test_the_first_leg_is_a_command_that_two_persons_release_and_the_filter_does_not_get(driver):
    check = begun(driver)
    assert (check.state, check.leg, check.legs, check.started_by) == ("running", 1, 4, "ann")
    effects = [type(effect) for effect in driver.confirm("bob").effects]
    assert UplinkEffect in effects
    effects += [type(effect) for effect in driver.send(Report(driver.at, 1, CommandTransition.EXECUTED)).effects]
    assert JournalEffect not in effects
    check = driver.state.sign_check
    assert (check.legs_done, check.leg, check.flown) == (1, None, (driver.command(1).schedule,))
    assert check.until_us == driver.command(1).start_us + 2700 * US


def test_a_leg_is_due_when_none_is_under_way_and_its_side_had_its_time(driver):
    check = begun(driver)
    assert not is_leg_due(check, driver.now_us)
    waiting = replace(check, leg=None)
    assert is_leg_due(waiting, driver.now_us)
    assert not is_leg_due(replace(waiting, state="open"), driver.now_us)
    assert not is_leg_due(replace(waiting, legs_done=check.legs), driver.now_us)
    flown = replace(waiting, legs_done=1, flown=(driver.command(1).schedule,))
    due_us = driver.command(1).start_us + round(profile_of("roll").legs[1].start_s * US)
    assert (is_leg_due(flown, due_us - 1), is_leg_due(flown, due_us)) == (False, True)


def test_a_second_check_and_a_first_leg_that_may_not_go_are_refused_and_change_nothing(driver):
    begun(driver)
    assert driver.send(BeginSignCheck(driver.at, "cas", "pitch", leg(driver))).refusal.code == "sign_check.running"
    idle = ReleaseDriver()
    idle.rows(1)
    assert idle.send(BeginSignCheck(idle.at, "ann", "roll", leg(idle))).refusal is not None
    assert idle.state.sign_check is None


def test_a_leg_that_was_lost_is_prepared_again_and_a_reason_against_it_is_shown(driver):
    begun(driver)
    driver.confirm("bob")
    driver.send(Report(driver.at, 1, CommandTransition.FAILED))
    assert (driver.state.sign_check.leg, driver.state.sign_check.legs_done) == (None, 0)
    driver.send(PrepareLeg(driver.at, Refusal("command.empty", "the drive cannot give it")))
    assert driver.state.sign_check.detail == "command.empty: the drive cannot give it"
    driver.send(PrepareLeg(driver.at, replace(leg(driver), schedule=())))
    assert driver.state.sign_check.detail.startswith("command.empty")
    driver.send(PrepareLeg(driver.at, leg(driver)))
    assert (driver.state.sign_check.leg, driver.state.sign_check.detail) == (2, "")


def test_a_leg_carried_out_in_part_interrupts(driver):
    begun(driver)
    driver.confirm("bob")
    start_us = driver.command(1).start_us
    driver.send(Report(driver.at, 1, CommandTransition.FAILED, start_us, start_us + 100 * US))
    check = driver.state.sign_check
    assert (check.state, check.detail) == ("interrupted", "leg 1 was carried out in part")


@pytest.mark.parametrize(
    ("verdict", "proven", "name"),
    [(SignState.PLUS, True, "ARMED"), (SignState.MINUS, False, "TRIPPED"), (SignState.CONTRADICTED, False, "ARMED")],
)
def test_a_verdict_ends_the_check_and_takes_its_open_leg_back(driver, verdict, proven, name):
    begun(driver)
    judged(driver, verdict)
    assert driver.state.sign_check.state == verdict.value
    assert driver.command(1).state is CommandState.CANCELLED
    assert ("roll" in driver.state.interlock.proven_axes, driver.name) == (proven, name)


def test_an_open_verdict_ends_the_check_when_its_time_is_over(driver):
    until_us = begun(driver).until_us
    judged(driver, SignState.OPEN)
    assert driver.state.sign_check.state == "running"
    driver.rows((until_us - driver.now_us) // (60 * US) + 1)
    judged(driver, SignState.OPEN)
    assert (driver.state.sign_check.state, driver.state.sign_check.detail) == ("open", "its time is over")


def test_a_trip_and_a_restart_interrupt(driver):
    begun(driver)
    assert restored(driver.state).sign_check.state == "interrupted"
    driver.order(OrderKind.STOP)
    assert (driver.state.sign_check.state, driver.command(1).state) == ("interrupted", CommandState.REJECTED)


#: of states without commands
NO_COMMAND = {}.__getitem__


def stories():
    yield ReleaseDriver()
    engaged = ReleaseDriver().engaged()
    engaged.automatic(is_reported=False)
    yield engaged
    armed = ReleaseDriver().armed()
    armed.engage("ann")
    armed.prepare()
    yield armed
    armed.order(OrderKind.STOP)
    yield armed


@pytest.mark.parametrize("driver", list(stories()))
def test_a_state_comes_back_equal(driver):
    check = SignCheck("roll", "running", 5, "ann", 9, 4, 1, log_ratio=SignRatios(0.0, -3.5, -math.inf))
    for state in (driver.state, replace(driver.state, sign_check=check)):
        assert state_of(document_of(state), driver.command) == state


def test_not_a_number_and_infinity_come_back():
    driver = ReleaseDriver().armed()
    driver.rows(1, replace(GOOD, attitude_deg=Axes(math.nan, -0.0, math.inf)))
    angles = state_of(document_of(driver.state), driver.command).interlock.row.attitude_deg
    assert repr(tuple(angles)) == "(nan, -0.0, inf)"


def test_of_commands_the_counters_are_stored():
    driver = ReleaseDriver().engaged()
    driver.automatic(is_reported=False)
    assert json.loads(document_of(driver.state))["state"]["commands"] == [1]


def test_an_empty_text_is_the_state_before_the_first_event():
    assert state_of("", NO_COMMAND) == ReleaseState()


@pytest.mark.parametrize(
    "change",
    [
        {"next_counter": "one"},
        {"interlock": {"state": "OPEN"}},
        {"commands": [{"state": "SENT"}]},
        {"former": 7},
        {"sent": 5},
        {"interlock": None},
        {"sent": [{"at_us": 1, "impulse_n_m_s": [0.0]}]},
    ],
)
def test_a_text_that_does_not_fit_is_refused(change):
    document = json.loads(document_of(ReleaseState()))
    with pytest.raises(ValueError, match=r"."):
        state_of(json.dumps({**document, "state": {**document["state"], **change}}), NO_COMMAND)
