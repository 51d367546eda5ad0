"""Sign check in the state: its legs are followed, and a verdict, a trip, a restart or its time ends it."""

from dataclasses import replace

import pytest
from release_driver import US, ReleaseDriver

from service.core.control.sign_check import SignState
from service.pipeline.control.release.advance import restored
from service.pipeline.control.release.command_states import CommandTransition
from service.pipeline.control.release.events import (
    BeginSignCheck,
    JournalEffect,
    OrderKind,
    PrepareLeg,
    Refusal,
    Report,
    SignJudged,
    UplinkEffect,
)
from service.pipeline.control.release.sign_checks import is_leg_due, profile_of
from service.records.operations.release import CommandState, Purpose


@pytest.fixture
def driver() -> ReleaseDriver:
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
