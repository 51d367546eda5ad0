"""States of a command: persons, digests, times, reports; each illegal step with its code and without effect."""

from dataclasses import replace

import numpy as np
import pytest
from release_driver import US, ReleaseDriver

from service.pipeline.control.release.advance import advance
from service.pipeline.control.release.command_states import (
    COMMAND_TRANSITIONS,
    OPEN,
    UNREPORTED,
    CommandState,
    CommandTransition,
    next_state,
)
from service.pipeline.control.release.command_transitions import pulses_between
from service.pipeline.control.release.events import (
    Automatic,
    Cancel,
    Confirm,
    JournalEffect,
    Prepare,
    Report,
    UplinkEffect,
    digest_of,
)
from service.pipeline.control.release.release_checks import release_checks, sent_within_an_hour
from service.records.levels.attitude import Axes
from service.records.levels.command import Pulse, ReleasedCommand, ReportedCommand


@pytest.fixture
def driver():
    return ReleaseDriver().armed()


def report(driver, turn, counter=1, **part):
    return driver.send(Report(driver.at, counter, turn, **part))


def test_what_has_gone_out_cannot_be_called_back_and_ends_are_ends():
    for life in UNREPORTED:
        assert not {
            CommandTransition.CANCEL,
            CommandTransition.EXPIRE,
            CommandTransition.REJECT,
            CommandTransition.RELEASE,
        } & set(COMMAND_TRANSITIONS[life])
    ends = set(CommandState) - OPEN - UNREPORTED
    assert all(COMMAND_TRANSITIONS[life] == {} for life in ends)
    assert next_state(CommandState.EXECUTED, CommandTransition.EXECUTED) is None


def test_a_command_is_prepared_confirmed_released_sent_and_executed(driver):
    assert driver.prepare("ann").refusal is None
    step = driver.confirm("bob")
    command = driver.command(1)
    journal, uplink, _ = step.effects
    assert journal == JournalEffect(ReleasedCommand(1, driver.now_us, command.schedule))
    assert isinstance(uplink, UplinkEffect)
    assert (uplink.product.counter, uplink.product.schedule) == (1, command.schedule)
    assert (command.state, command.prepared_by, command.confirmed_by) == (CommandState.RELEASED, "ann", "bob")
    report(driver, CommandTransition.SENT)
    step = report(driver, CommandTransition.EXECUTED)
    assert step.effects[0] == JournalEffect(ReportedCommand(1, driver.now_us, command.schedule))
    assert driver.command(1).executed == command.schedule


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"digest": "0" * 64}, "command.digest"),
        ({"by": "ann"}, "command.second_person"),
        ({"is_approver": False}, "command.second_person"),
        ({"counter": 2}, "command.unknown"),
    ],
)
def test_confirmations_that_do_not_hold_are_refused(driver, change, code):
    driver.prepare("ann")
    command = driver.command(1)
    given = {"by": "bob", "counter": 1, "digest": command.digest, "is_approver": True, **change}
    assert driver.send(Confirm(driver.at, **given)).refusal.code == code
    assert driver.command(1) == command


def test_two_operators_at_once_meet_a_clear_answer(driver):
    driver.prepare("ann")
    assert driver.prepare("cas").refusal.code == "command.open"
    driver.confirm("bob")
    assert driver.confirm("cas").refusal.code == "command.state"
    assert driver.send(Cancel(driver.at, "ann", 1)).refusal.code == "command.state"
    assert driver.prepare("cas").refusal.code == "command.unreported"


def test_confirmation_after_expiry_is_refused(driver):
    driver.prepare("ann")
    driver.rows(10)
    assert driver.confirm("bob").refusal.code == "command.expired"
    assert driver.command(1).state is CommandState.EXPIRED


def test_a_cancelled_command_makes_room(driver):
    driver.prepare("ann")
    assert driver.send(Cancel(driver.at, "ann", 1)).refusal is None
    assert driver.prepare("ann").refusal is None
    assert driver.command(2).digest != driver.command(1).digest


def test_reports_for_unknown_or_finished_commands_are_refused(driver):
    assert report(driver, CommandTransition.EXECUTED, counter=9).refusal.code == "command.unknown"
    driver.prepare()
    assert report(driver, CommandTransition.EXECUTED).refusal.code == "command.state"
    driver.confirm()
    report(driver, CommandTransition.FAILED)
    assert report(driver, CommandTransition.FAILED).refusal.code == "command.state"
    assert report(driver, CommandTransition.SENT).refusal.code == "command.state"
    assert report(driver, CommandTransition.CONFIRM).refusal.code == "command.state"


def test_an_interval_that_ends_before_it_begins_is_refused(driver):
    driver.prepare()
    driver.confirm()
    step = report(
        driver, CommandTransition.EXECUTED, executed_from_us=driver.now_us, executed_until_us=driver.now_us - 1
    )
    assert step.refusal.code == "report.interval"


def test_a_command_that_failed_half_way_is_known_input_as_far_as_it_went(driver):
    driver.prepare()
    driver.confirm()
    command = driver.command(1)
    middle_us = command.start_us + 100 * US
    step = report(driver, CommandTransition.FAILED, executed_from_us=command.start_us, executed_until_us=middle_us)
    assert step.effects[0] == JournalEffect(ReportedCommand(1, driver.now_us, command.schedule[:1]))
    # the first pulse went, the one that nulls the rate did not: the spacecraft is turning
    assert driver.command(1).executed == command.schedule[:1]


def test_a_pulse_that_was_cut_is_cut_in_the_record():
    pulse = Pulse(10 * US, 4.0, Axes(0.0, 0.002, 0.0))
    (part,) = pulses_between((pulse,), 11 * US, 13 * US)
    assert part == Pulse(11 * US, 2.0, Axes(0.0, 0.002, 0.0))
    assert pulses_between((pulse,), 0, 9 * US) == ()
    assert pulses_between((pulse,), 0, 20 * US) == (pulse,)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"schedule_verdict": "reject"}, "schedule.rejected"),
        ({"schedule_verdict": ""}, "schedule.rejected"),
        ({"schedule": ()}, "command.empty"),
        ({"start_us": 0}, "command.start_passed"),
        ({"start_us": 2**62}, "command.too_long"),
        ({"attitude_epoch_us": 1}, "command.estimate_stale"),
        ({"attitude_epoch_us": 2**62}, "command.estimate_stale"),
    ],
)
def test_proposals_that_must_not_go_are_refused(driver, change, code):
    proposal = replace(driver.proposal(), **change)
    assert driver.send(Prepare(driver.at, "ann", proposal)).refusal.code == code


@pytest.mark.parametrize(
    "wanted",
    [
        {"roll_deg": 0.11, "horizon_s": 3600.0},
        {"roll_deg": 0.09, "horizon_s": 300.0},
        {"roll_deg": 0.0, "pitch_deg": 0.1, "horizon_s": 300.0},
    ],
)
def test_beyond_the_envelope_a_command_is_refused_never_clipped(driver, wanted):
    refusal = driver.prepare(**wanted).refusal
    assert refusal.code == "envelope.exceeded"
    assert " of " in refusal.detail


def test_the_hour_holds_over_many_commands_and_frees_itself():
    driver, went = ReleaseDriver().engaged(), 0
    for _ in range(20):
        driver.rows(5, lag_s=0.0)
        step = driver.send(Prepare(driver.at, "ann", driver.proposal(roll_deg=0.08, horizon_s=900.0)))
        if step.refusal is not None:
            break
        driver.confirm("bob")
        report(driver, CommandTransition.EXECUTED, counter=driver.state.commands[-1].counter)
        went += 1
    assert step.refusal.code == "envelope.exceeded"
    # 0.008964 N m s each
    assert went == 11
    assert sent_within_an_hour(driver.state, driver.now_us)[1] == pytest.approx(11 * 0.008964, rel=1e-3)
    driver.rows(60)
    assert driver.prepare(roll_deg=0.08).refusal is None


def test_an_authorised_envelope_that_is_narrower_holds_without_a_trip():
    driver = ReleaseDriver().armed()
    narrow = driver.settings.envelope._replace(angle_change_deg=0.03)
    for person in ("ann", "bob"):
        step = driver.engage(person)
        assert step.refusal is None
    authorisation = driver.state.interlock.authorisation
    terms = replace(authorisation.terms, envelope=narrow)
    interlock = replace(driver.state.interlock, authorisation=replace(authorisation, terms=terms))
    driver.state = replace(driver.state, interlock=interlock)
    assert driver.automatic(roll_deg=0.05).refusal.code == "envelope.exceeded"
    assert driver.name == "ENGAGED"
    assert driver.prepare(roll_deg=0.05).refusal is None


def test_checks_tell_all_that_is_wrong_at_once(driver):
    proposal = replace(driver.proposal(roll_deg=0.11, horizon_s=3600.0), schedule_verdict="reject")
    checks = release_checks(
        driver.state, proposal, driver.at, driver.settings, envelope=driver.settings.envelope, waiting_s=0.0
    )
    assert [check.name for check in checks if not check.is_ok] == ["envelope", "flexible response"]


def test_the_digest_changes_with_the_last_bit(driver):
    proposal = driver.proposal()
    first = proposal.schedule[0]
    torque_n_m = first.torque_n_m._replace(roll=np.nextafter(first.torque_n_m.roll, 1.0).item())
    nudged = replace(first, torque_n_m=torque_n_m)
    others = [
        digest_of(2, proposal),
        digest_of(1, replace(proposal, start_us=proposal.start_us + 1)),
        digest_of(1, replace(proposal, schedule=(nudged, *proposal.schedule[1:]))),
    ]
    assert len({digest_of(1, proposal), *others}) == 4
    assert digest_of(1, proposal) == digest_of(1, replace(proposal))


def test_commands_that_ended_an_hour_ago_are_forgotten_and_waiting_ones_never(driver):
    driver.prepare()
    driver.confirm()
    driver.rows(150)
    assert driver.command(1).state is CommandState.RELEASED
    report(driver, CommandTransition.EXECUTED)
    driver.rows(61)
    assert driver.state.commands == ()


def test_a_report_is_late_ten_minutes_after_the_end_of_the_schedule(driver):
    driver.prepare()
    driver.confirm()
    over_us = driver.command(1).stop_us + 600 * US
    driver.rows((over_us - driver.now_us) // (60 * US))
    assert driver.name == "ARMED"
    driver.rows(1)
    assert driver.name == "INHIBITED"
    assert driver.alarms == ["report_late"]


def test_a_command_from_an_estimate_that_was_used_is_refused():
    driver = ReleaseDriver().engaged()
    assert driver.automatic().refusal is None
    assert driver.automatic().refusal.code == "command.duplicate"
    driver.rows(1)
    assert driver.automatic().refusal is None


def test_the_law_gets_no_time_to_look_at_an_estimate_and_persons_get_ten_minutes():
    driver = ReleaseDriver().engaged()
    old = driver.proposal()
    driver.rows(4)
    assert driver.send(Automatic(driver.at, old)).refusal.code == "command.estimate_stale"
    assert driver.send(Prepare(driver.at, "ann", old)).refusal is None


def test_the_same_events_lead_to_the_same_state(driver):
    event = Prepare(driver.at, "ann", driver.proposal())
    assert advance(driver.state, event, driver.settings) == advance(driver.state, event, driver.settings)
