"""States of a released command, its refusals, and the verdict on control with its conditions."""

import re
from dataclasses import replace

import numpy as np
import pytest
from release_driver import US, ReleaseDriver
from release_service_driver import GOOD, ReleaseServiceDriver
from scripted_release_service import CONTROL

from service.pipeline.config import InterlockConfig
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
from service.pipeline.control.release.control_verdict import (
    _NEXT_STEPS,
    CODES,
    control_conditions,
    control_verdict,
    reason_of,
)
from service.pipeline.control.release.events import (
    Automatic,
    Cancel,
    Confirm,
    JournalEffect,
    OrderKind,
    Prepare,
    Report,
    UplinkEffect,
    digest_of,
)
from service.pipeline.control.release.interlock_conditions import (
    Condition,
    InterlockInputs,
    ReleaseSettings,
    input_values,
    interlock_row,
)
from service.pipeline.control.release.release_checks import release_checks, sent_within_an_hour
from service.records.catalogue import Release
from service.records.levels.attitude import Axes, Pulse, ReleasedCommand, ReportedCommand, Status


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
        {"roll_deg": 0.21, "horizon_s": 3600.0},
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
    proposal = replace(driver.proposal(roll_deg=0.21, horizon_s=3600.0), schedule_verdict="reject")
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


def codes(verdict):
    return [reason.code for reason in verdict.reasons]


def test_every_reason_has_one_text_and_one_next_step():
    stated = [code for codes in _NEXT_STEPS.values() for code in codes.split()]
    assert sorted(stated) == sorted(CODES)
    for code in CODES:
        reason = reason_of(code)
        assert reason.text
        assert "{" not in reason.text
        assert reason.next_step.endswith(".")


def test_rows_of_every_status_have_reasons_in_words():
    for status in Status:
        facts = interlock_row(replace(GOOD, status=status), None, 60.0, is_innovation_in_band=True)
        assert set(facts.inhibitions) <= CODES | {"not_received"}, "rows are received"
    # a row without angles, told by the service
    driver = ReleaseServiceDriver()
    driver.rows(1, status=Status.INVALID, inhibitions=("no_fix",), control_allowed=False)
    assert codes(driver.verdict) == ["no_fix", "invalid", "not_armed", "yaw_sign"]
    assert driver.verdict.reasons[1].text == "the newest row gives no attitude"
    # what another version has stored is told as it is
    stored = control_verdict(CONTROL, replace(GOOD, inhibitions=("of_old",)))
    assert (stored.is_allowed, stored.reasons[0].text) == (False, "of_old")


def test_the_reason_to_act_on_comes_first():
    row = replace(GOOD, status=Status.INVALID, inhibitions=("not_aligned",), control_allowed=False)
    view = replace(CONTROL, state="INHIBITED", reasons=(reason_of("estimate_old"), reason_of("yaw_sign")))
    assert codes(control_verdict(view, row)) == ["not_aligned", "estimate_old", "yaw_sign"], "links are not to blame"
    verdict = control_verdict(view, replace(GOOD, inhibitions=("redundancy",)), "KeyError: 'gain'")
    assert codes(verdict)[:2] == ["estimator_failed", "redundancy"]
    assert verdict.reasons[0].text == "the estimator fails, no attitude is computed: KeyError: 'gain'"
    assert (verdict.is_allowed, verdict.state) == (False, "INHIBITED")


@pytest.mark.parametrize(
    ("age_s", "words"), [(211.0, "3.5 min"), (233_280.0, "2.7 days"), (40 * 60.0, "40.0 min"), (7_200.0, "2.0 h")]
)
def test_reasons_of_an_old_row_are_not_those_of_the_present(age_s, words):
    row = replace(GOOD, status=Status.EXPIRED, inhibitions=("catch_up", "redundancy", "expired"), control_allowed=False)
    view = replace(CONTROL, state="INHIBITED", reasons=(reason_of("yaw_sign"),))
    verdict = control_verdict(view, row, age_s=age_s)
    assert codes(verdict) == ["expired", "yaw_sign"]
    assert verdict.reasons[0].text == f"the newest row is {words} old"
    assert codes(control_verdict(view, row)) == ["expired", "yaw_sign"]


def test_figures_are_those_of_the_settings():
    settings = ReleaseSettings(hand_over_deg=0.7, ephemeris_ahead_s=4 * 3600.0, good_s=120.0)
    assert "0.7 deg" in reason_of("hand_over", settings=settings).text
    assert "4 h" in reason_of("ephemeris", settings=settings).text
    assert "2 minutes" in reason_of("good_minutes", settings=settings).text
    assert re.search(r"80 %", reason_of("momentum").text)


@pytest.mark.parametrize("state", ["ARMED", "ENGAGED", "RECOVERY"])
def test_while_neither_forbids_it_is_allowed_and_yaw_alone_may_be_withheld(state):
    verdict = control_verdict(replace(CONTROL, state=state), GOOD)
    assert (verdict.is_allowed, verdict.state, codes(verdict)) == (True, state, ["yaw_sign"])


@pytest.mark.parametrize("release", ["two_step", "automatic"])
def test_a_row_that_forbids_forbids(release):
    row = replace(GOOD, inhibitions=("downlink_fade",), control_allowed=False)
    verdict = control_verdict(replace(CONTROL, release=release), row)
    assert (verdict.is_allowed, codes(verdict)) == (False, ["downlink_fade", "yaw_sign"])
    assert verdict.state == ("INHIBITED" if release == "automatic" else "ARMED")


def test_nothing_known_forbids():
    assert codes(control_verdict(None, None)) == ["release_unreadable", "no_attitude"]
    assert control_verdict(None, GOOD).state == "INHIBITED"
    assert not control_verdict(None, GOOD).is_allowed
    assert not control_verdict(CONTROL, None).is_allowed


def test_a_trip_forbids_whatever_the_row_says():
    view = replace(CONTROL, state="TRIPPED", reasons=(reason_of("stop", 5),), release="automatic")
    verdict = control_verdict(view, GOOD)
    assert (verdict.is_allowed, verdict.state, codes(verdict)) == (False, "TRIPPED", ["stop"])


def test_reasons_tell_since_when_they_stand_without_a_break():
    driver = ReleaseServiceDriver()
    driver.rows(3)
    driver.rows(1, downlink_fade=True)
    began_us = driver.clock.now
    driver.rows(3, downlink_fade=True)
    since = {reason.code: reason.since_us for reason in driver.view.reasons}
    assert since["fade"] == began_us
    driver.rows(1)
    driver.rows(1, downlink_fade=True)
    since = {reason.code: reason.since_us for reason in driver.view.reasons}
    assert since["fade"] == driver.clock.now
    # a restart forgets what has not tripped, and keeps a trip's instant
    driver.order(OrderKind.STOP)
    stopped_us = driver.clock.now
    driver.restart()
    driver.rows(2)
    since = {reason.code: reason.since_us for reason in driver.view.reasons}
    assert since["stop"] == stopped_us
    assert since["yaw_sign"] > stopped_us


def test_after_a_reset_automatic_control_waits_for_ten_good_minutes_also_over_a_restart():
    driver = ReleaseServiceDriver()
    driver.archive.change_spacecraft(release=Release.AUTOMATIC)
    driver.rows(2)
    assert driver.verdict.is_allowed
    assert codes(driver.verdict) == []
    driver.order(OrderKind.STOP)
    assert driver.verdict.state == "TRIPPED"
    driver.rows(20)
    driver.order(OrderKind.RESET)
    assert (driver.verdict.state, codes(driver.verdict)) == ("INHIBITED", ["good_minutes"])
    driver.rows(8)
    assert (driver.verdict.is_allowed, driver.view.is_withheld) == (False, True)
    driver.restart()
    driver.rows(8)
    assert (driver.verdict.is_allowed, driver.view.is_withheld) == (False, True)
    # a bad row begins them again
    driver.rows(1, downlink_fade=True)
    driver.rows(10)
    assert not driver.verdict.is_allowed
    assert driver.releases.reported[-1].is_withheld
    driver.rows(2)
    assert (driver.verdict.state, driver.verdict.is_allowed, driver.view.is_withheld) == ("ENGAGED", True, False)
    assert driver.releases.reported[-1].is_withheld is False
    assert driver.releases.reported[-1].at_us == driver.clock.now - 60 * US


def test_the_estimators_own_reasons_are_told_in_place_of_one_for_all():
    driver = ReleaseServiceDriver()
    driver.rows(1, inhibitions=("chain_step",), control_allowed=False)
    assert codes(driver.verdict) == ["chain_step", "not_armed", "yaw_sign"]
    driver = ReleaseServiceDriver().armed()
    # by its own wider limits the interlock stays armed; the row forbids all the same
    driver.rows(1, attitude_deg=Axes(0.0, 0.35, 0.0), inhibitions=("beyond_validity",), control_allowed=False)
    assert (driver.state, driver.verdict.is_allowed) == ("ARMED", False)


def conditions_of(driver, **limits):
    found = control_conditions(driver.view, driver.row, driver.verdict, InterlockConfig(**limits))
    return {each.code: each for each in found}


def test_every_code_of_a_verdict_is_listed_once_but_the_one_that_stands_for_a_trip():
    driver = ReleaseServiceDriver()
    found = control_conditions(driver.view, driver.row, driver.verdict, InterlockConfig())
    assert sorted(each.code for each in found) == sorted(CODES - {"tripped"})


def test_before_the_first_row_nothing_of_it_is_judged():
    driver = ReleaseServiceDriver()
    driver.archive.is_aligned = False
    found = conditions_of(driver)
    assert {code for code, each in found.items() if each.is_met is False} == {
        "estimate_old",
        "not_aligned",
        "no_attitude",
        "not_armed",
        "yaw_sign",
    }
    for code in ("sigma_roll", "fade", "hand_over", "no_fix", "protection_level", "expired", "mode_off"):
        assert (found[code].is_met, found[code].value) == (None, None), code
    assert found["sigma_roll"].limit == 0.06
    assert (found["estimate_old"].limit, found["innovation"].value) == (None, None)
    assert (found["good_minutes"].is_met, found["good_minutes"].value) == (None, 0.0)
    assert found["momentum"].is_met, "a momentum that no telemetry tells is passed over"


def test_what_cannot_be_read_is_not_judged():
    verdict = control_verdict(None, GOOD)
    found = {each.code: each for each in control_conditions(None, GOOD, verdict, InterlockConfig())}
    assert found["release_unreadable"].is_met is False
    assert (found["stop"].is_met, found["sigma_roll"].value, found["good_minutes"].limit) == (None, 0.02, None)
    assert found["downlink_fade"].is_met


def test_values_stand_beside_their_limits():
    driver = ReleaseServiceDriver()
    row = {"attitude_deg": Axes(0.1, -0.3, 0.2), "protection_deg": Axes(0.5, 0.1, 0.3)}
    driver.rows(4, lag_s=20.0, **row, inhibitions=("protection_level",), control_allowed=False)
    driver.archive.ephemeris_stop_us = driver.clock.now + 7 * 3600 * US
    driver.momentum(10.0)
    found = conditions_of(driver, alert_limit_deg=0.25)
    told = {code: (each.value, each.limit, each.bound, each.unit) for code, each in found.items()}
    assert told["estimate_old"] == (20.0, 210.0, "greatest", "s")
    assert told["sigma_pitch"] == (0.03, 0.10, "greatest", "deg")
    assert told["redundancy"] == (9, 2, "least", "")
    assert told["ephemeris"] == (7 * 3600.0, 6 * 3600.0, "least", "s")
    assert told["hand_over"] == (0.3, 2.0, "greatest", "deg")
    assert told["beyond_validity"] == (0.3, 2.0, "greatest", "deg")
    assert told["protection_level"] == (0.3, 0.25, "greatest", "deg")
    assert told["momentum"] == (pytest.approx(50.0), 80.0, "greatest", "%")
    assert told["innovation"] == (0.0, 1800.0, "greatest", "s")
    assert told["stop"] == (None, None, None, "")
    assert found["protection_level"].since_us == driver.clock.now - 3 * 60 * US
    # the row's own reasons stand in place of one for all
    assert (found["estimator"].is_met, found["protection_level"].is_met) == (None, False)


def test_where_a_torque_acts_the_level_is_held_against_the_nominal_one_and_sigma_against_nothing():
    driver = ReleaseServiceDriver()
    levels = {"protection_deg": Axes(0.5, 0.1, 0.28), "nominal_protection_deg": Axes(0.4, 0.1, 0.2)}
    driver.rows(1, **levels, waiting_loss_deg=Axes(0.9, 0.05, 0.11))
    found = conditions_of(driver)
    assert (found["protection_level"].value, found["protection_level"].limit) == (0.28, pytest.approx(0.3))
    assert (found["sigma_pitch"].value, found["sigma_pitch"].limit) == (0.03, None)
    driver.rows(1, **levels, waiting_loss_deg=Axes(0.9, 0.05, 0.09))
    found = conditions_of(driver)
    assert (found["protection_level"].limit, found["sigma_pitch"].limit) == (0.22, 0.1)


def test_a_fade_without_a_size_is_not_a_fade_of_zero():
    driver = ReleaseServiceDriver()
    driver.rows(1)
    assert conditions_of(driver)["fade"].value == 0.0
    driver.rows(1, downlink_fade=True)
    assert conditions_of(driver)["fade"].value is None
    driver.rows(1, downlink_fade=True, downlink_fade_db=4.1)
    found = conditions_of(driver)
    assert (found["fade"].value, found["downlink_fade"].value, found["fade"].limit) == (4.1, 4.1, None)


def test_the_good_minutes_are_counted():
    driver = ReleaseServiceDriver()
    driver.rows(1)
    began_us = driver.clock.now
    driver.rows(4)
    good = driver.view.good_minutes
    assert (good.since_us, good.elapsed_s, good.needed_s) == (began_us, 240.0, 600.0)
    assert conditions_of(driver)["good_minutes"].is_met is None, "arming asks for them, nothing else does"
    driver.rows(1, downlink_fade=True)
    assert (driver.view.good_minutes.since_us, driver.view.good_minutes.elapsed_s) == (None, 0.0)
    driver.rows(30)
    assert driver.view.good_minutes.elapsed_s == 600.0
    driver.order(OrderKind.ARM)
    assert all(each.is_met for each in conditions_of(driver).values() if each.consequence != "yaw")
    driver.rows(1, downlink_fade=True)
    driver.rows(3)
    found = conditions_of(driver)
    assert (found["good_minutes"].is_met, found["good_minutes"].value) == (False, 120.0)


def test_reports_that_are_owed_are_counted():
    driver = ReleaseServiceDriver().armed()
    command = driver.sent()
    driver.rows(1)
    found = conditions_of(driver)
    assert (found["unreported"].value, found["unreported"].limit) == (1, 1)
    assert found["report_late"].value == 0.0, "it is still flown"
    driver.pass_time((command.stop_us - driver.clock.now) / US + 90.0)
    assert conditions_of(driver)["report_late"].value == 90.0


def test_angles_that_are_not_numbers_have_no_value():
    nan = float("nan")
    row = replace(GOOD, attitude_deg=Axes(nan, nan, 0.1), inhibitions=("of_old",))
    found = control_conditions(None, row, control_verdict(None, row), InterlockConfig())
    values = {each.code: each for each in found}
    assert values["beyond_validity"].value is None
    assert (found[-1].code, found[-1].is_met, found[-1].consequence) == ("of_old", False, "inhibit")


def test_limits_hold_before_the_first_row_and_an_ephemeris_is_not_counted_from_a_clock_that_has_no_time():
    found = {each.code: each for each in control_conditions(None, None, control_verdict(None, None), InterlockConfig())}
    limits = (InterlockConfig().model_range_deg, InterlockConfig().alert_limit_deg)
    assert (found["beyond_validity"].limit, found["protection_level"].limit) == limits
    assert (found["beyond_validity"].value, found["protection_level"].value) == (None, None)
    inputs = InterlockInputs(ephemeris_stop_us=1_800_000_000 * US)
    assert input_values(inputs, 1_799_999_000 * US)[Condition.EPHEMERIS] == 1000.0
    assert Condition.EPHEMERIS not in input_values(inputs, 0)
