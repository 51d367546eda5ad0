"""The verdict on control: interlock and newest row alike forbid, every reason has a text and a next step."""

import re
from dataclasses import replace

import pytest
from release_service_driver import GOOD, US, ReleaseServiceDriver
from scripted_release_service import CONTROL

from service.pipeline.control.release.control_verdict import _NEXT_STEPS, CODES, control_verdict, reason_of
from service.pipeline.control.release.events import OrderKind
from service.pipeline.control.release.interlock_conditions import interlock_row
from service.pipeline.control.release.settings import ReleaseSettings
from service.records.catalogue import Release
from service.records.levels.attitude import Axes, Status


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
        facts = interlock_row(replace(GOOD, status=status), 60.0, is_innovation_in_band=True)
        assert set(facts.inhibitions) <= CODES | {"not_received"}, "rows are received"
    # a row without angles, told by the service
    driver = ReleaseServiceDriver()
    driver.rows(1, status=Status.INVALID, inhibitions=("no_fix",), control_allowed=False)
    assert codes(driver.verdict) == ["no_fix", "invalid", "yaw_sign", "not_armed"]
    assert driver.verdict.reasons[1].text == "the newest row gives no attitude"
    # what another version has stored is told as it is
    stored = control_verdict(CONTROL, replace(GOOD, inhibitions=("of_old",)))
    assert (stored.is_allowed, stored.reasons[0].text) == (False, "of_old")


def test_the_reason_to_act_on_comes_first():
    row = replace(GOOD, status=Status.INVALID, inhibitions=("not_aligned",), control_allowed=False)
    view = replace(CONTROL, state="INHIBITED", reasons=(reason_of("estimate_old"), reason_of("yaw_sign")))
    assert codes(control_verdict(view, row)) == ["not_aligned", "estimate_old", "yaw_sign"], "links are not to blame"
    row = replace(GOOD, status=Status.EXPIRED, inhibitions=("expired", "redundancy"), control_allowed=False)
    assert codes(control_verdict(view, row))[0] == "redundancy"


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
    assert codes(driver.verdict) == ["chain_step", "yaw_sign", "not_armed"]
    driver = ReleaseServiceDriver().armed()
    # by its own wider limits the interlock stays armed; the row forbids all the same
    driver.rows(1, attitude_deg=Axes(0.0, 0.35, 0.0), inhibitions=("beyond_validity",), control_allowed=False)
    assert (driver.state, driver.verdict.is_allowed) == ("ARMED", False)
