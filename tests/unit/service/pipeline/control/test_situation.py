"""Claims about the worst that is true of a spacecraft now."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.pipeline.control.release.control_verdict import ControlVerdict, reason_of
from service.pipeline.control.situation import SITUATIONS, situation_of
from service.records.catalogue import Method
from service.records.levels.attitude import NO_ANGLES, Axes, Exclusion, Status, row_without_attitude

LIMIT_DEG = 0.4
ROW = replace(
    row_without_attitude(0, 0, 1, Method.ROBUST, ()),
    status=Status.ACQUIRED,
    attitude_deg=Axes(0.3, 0.05, -0.1),
    sigma_deg=Axes(0.3, 0.02, 0.03),
    protection_deg=Axes(1.2, 0.081, 0.12),
    carriers_used=12,
)
ABSENT = tuple(Exclusion(f"c{k:02d}", "absent") for k in range(12))
#: 4.95 deg of roll, by predictions alone
AWAY = replace(ROW, status=Status.EXPIRED, attitude_deg=Axes(1.0, 4.95, 0.5), carriers_used=0)


def verdict(*codes, allowed=False, state="INHIBITED"):
    return ControlVerdict(allowed, state, tuple(reason_of(code) for code in codes))


def found(row=ROW, said=None, limit_deg=LIMIT_DEG):
    return situation_of(row, said or verdict(allowed=True, state="ENGAGED"), limit_deg)


def pitching(angle_deg, rate_deg_h):
    row = replace(ROW, attitude_deg=ROW.attitude_deg._replace(pitch=angle_deg))
    return replace(row, rates_deg_s=Axes(0.0, 0.0, rate_deg_h / 3600.0))


def test_known_is_the_protection_level_rounded_up_and_yaw_is_always_said():
    assert found().code == "known"
    assert (found().known_deg, found().yaw_known_deg) == (0.12, 1.2)
    assert found(replace(ROW, protection_deg=Axes(1.2, 0.1201, 0.12))).known_deg == 0.13, "never better than it is"
    two_sigma = found(replace(ROW, protection_deg=NO_ANGLES))
    assert (two_sigma.known_deg, two_sigma.yaw_known_deg) == (0.06, 0.6)


@pytest.mark.parametrize(
    ("said", "severity"),
    [
        (verdict(allowed=True, state="ARMED"), "normal"),
        (verdict("yaw_uncertain", allowed=True, state="ARMED"), "caution"),
        (verdict("stop"), "serious"),
        (verdict("momentum", state="TRIPPED"), "critical"),
    ],
)
def test_control_decides_the_severity_where_the_angles_are_known(said, severity):
    assert found(said=said).severity == severity


def test_a_spacecraft_whose_carriers_are_all_gone_is_not_said_to_have_an_uncertain_roll():
    said = verdict("sigma_roll", "redundancy", "invalid", state="TRIPPED")
    dark = found(replace(AWAY, excluded=ABSENT), said)
    assert (dark.code, dark.severity, dark.axis, dark.angle_deg) == ("dark", "critical", "roll", 4.95)
    lost = found(replace(AWAY, excluded=(*ABSENT[:-1], Exclusion("c11", "step"))), said)
    assert (lost.code, lost.axis) == ("lost", "roll")
    assert math.isnan(lost.known_deg)


@pytest.mark.parametrize("said", [verdict("stop"), verdict(allowed=True, state="ENGAGED")], ids=["stopped", "allowed"])
def test_an_angle_beyond_its_limit_is_said_whatever_control_does(said):
    growing = found(pitching(-2.56, -0.31), said)
    assert (growing.code, growing.severity, growing.axis) == ("beyond_and_growing", "critical", "pitch")
    assert (growing.angle_deg, growing.limit_deg) == (-2.56, LIMIT_DEG)
    assert growing.rate_deg_h == pytest.approx(0.31)
    back = found(pitching(-2.56, 0.31), said)
    assert (back.code, back.rate_deg_h) == ("beyond_limit", pytest.approx(-0.31))


def test_an_angle_that_grows_towards_its_limit_says_when():
    soon = found(pitching(0.3, 0.1))
    assert (soon.code, soon.severity, soon.axis) == ("towards_limit", "serious", "pitch")
    assert soon.hours_to_limit == pytest.approx(1.0)
    # slower than a command period, towards zero, and near zero
    assert [found(pitching(*each)).code for each in ((0.3, 0.04), (0.3, -0.5), (0.1, 0.5))] == ["known"] * 3


def test_yaw_is_beyond_its_limit_when_it_surely_is():
    assert found(replace(ROW, attitude_deg=Axes(0.9, 0.0, 0.0))).code == "known"
    assert found(replace(ROW, attitude_deg=Axes(1.1, 0.0, 0.0))).axis == "yaw"


def test_nothing_is_known_before_the_first_row_of_old_rows_and_of_an_estimator_that_fails():
    assert found(None, verdict("no_attitude")).code == "no_attitude"
    assert found(replace(ROW, status=Status.INVALID, attitude_deg=NO_ANGLES)).code == "no_angles"
    assert found(AWAY, verdict("expired")).code == "old"
    failed = found(AWAY, verdict("estimator_failed", "expired"))
    assert (failed.code, failed.severity) == ("estimator_failed", "critical")


@given(
    angles=st.tuples(*[st.floats(-9.0, 9.0)] * 3),
    rates=st.tuples(*[st.floats(-1e-3, 1e-3)] * 3),
    sigma=st.floats(1e-3, 2.0),
    status=st.sampled_from(list(Status)),
)
def test_every_row_has_one_situation_and_nothing_beyond_its_limit_is_called_known(angles, rates, sigma, status):
    row = replace(
        ROW, attitude_deg=Axes(*angles), rates_deg_s=Axes(*rates), sigma_deg=Axes(sigma, 0.02, 0.03), status=status
    )
    situation = found(row)
    assert situation.code in SITUATIONS
    is_within = max(abs(angles[1]), abs(angles[2])) <= LIMIT_DEG
    assert (situation.code in ("known", "towards_limit")) <= (is_within and status is Status.ACQUIRED)
    assert math.isnan(situation.known_deg) == (situation.code != "known")
