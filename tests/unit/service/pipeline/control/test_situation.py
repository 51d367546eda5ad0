"""Claims about the worst that is true of a spacecraft now."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.pipeline.control.release.control_verdict import ControlVerdict, reason_of
from service.pipeline.control.situation import SITUATIONS, recent_rate, situation_of
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
#: the same, as the service answers it once no row comes any more
OLD = replace(AWAY, inhibitions=("redundancy", "expired"))


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
    said = verdict("sigma_roll", "redundancy", "expired", "invalid", state="TRIPPED")
    dark = found(replace(AWAY, excluded=ABSENT), said)
    assert (dark.code, dark.severity, dark.axis, dark.angle_deg) == ("dark", "critical", "roll", 4.95)
    lost = found(replace(AWAY, excluded=(*ABSENT[:-1], Exclusion("c11", "step"))), said)
    assert (lost.code, lost.axis) == ("lost", "roll")
    assert math.isnan(lost.known_deg)


def test_an_old_row_says_its_last_angle_in_red_where_that_was_beyond_its_limit():
    old = found(replace(OLD, excluded=ABSENT), verdict("stop", "expired"))
    assert (old.code, old.severity, old.axis, old.angle_deg) == ("old", "critical", "roll", 4.95)
    within = found(replace(OLD, attitude_deg=Axes(0.9, 0.05, -0.1)), verdict("expired"))
    assert (within.code, within.severity, within.axis, within.angle_deg) == ("old", "serious", "yaw", 0.9)
    assert found(replace(OLD, attitude_deg=Axes(0.9, 0.05, -0.45))).axis == "pitch"


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


def motion(row, axis="pitch", rate=None):
    (found_motion,) = [each for each in situation_of(row, verdict(), LIMIT_DEG, rate).axes if each.axis == axis]
    return found_motion


def test_an_axis_that_goes_through_zero_meets_the_other_limit_and_a_slow_one_none():
    back = motion(pitching(0.1, -0.5))
    assert (back.rate_deg_h, back.hours_to_limit, back.is_beyond) == pytest.approx((-0.5, 1.0, False))
    for rate_deg_h in (0.0, 0.012, math.nan):
        assert math.isnan(motion(pitching(0.1, rate_deg_h)).hours_to_limit)
    outside = motion(pitching(-0.5, -0.1))
    assert (outside.is_beyond, math.isnan(outside.hours_to_limit)) == (True, True)


@pytest.mark.parametrize(
    ("row", "said"), [(OLD, verdict("expired")), (AWAY, verdict()), (ROW, verdict("estimator_failed"))]
)
def test_of_a_row_that_is_no_present_angles_alone_are_known(row, said):
    is_away, row = row is not ROW, replace(row, rates_deg_s=Axes(1e-5, 1e-5, 1e-5))
    axes = found(row, said).axes
    assert [each.axis for each in axes] == ["yaw", "roll", "pitch"]
    assert [each.angle_deg for each in axes] == list(row.attitude_deg)
    assert [each.is_beyond for each in axes] == [False, is_away, is_away]
    assert all(math.isnan(each.rate_deg_h) and math.isnan(each.hours_to_limit) for each in axes)
    assert found(replace(ROW, attitude_deg=Axes(math.nan, 0.05, math.nan))).axes[0].axis == "roll"
    assert found(None, verdict("no_attitude")).axes == ()


def minutes(count, angle_of):
    """Return rows of so many minutes, the newest at `count` - 1."""
    return [
        replace(ROW, epoch_us=60_000_000 * k, attitude_deg=Axes(0.3, 0.05, angle_of(k / 60.0))) for k in range(count)
    ]


def test_the_rate_is_the_slope_of_the_last_half_hour_and_the_same_in_the_sentence_and_of_the_axis():
    rows = minutes(31, lambda hours: 0.01 + 0.5 * hours)
    rate = recent_rate(rows)
    assert [3600.0 * each for each in rate] == pytest.approx([0.0, 0.0, 0.5], abs=1e-9)
    newest = replace(rows[-1], rates_deg_s=Axes(0.0, 0.0, 1e-6))
    situation = situation_of(newest, verdict(), LIMIT_DEG, rate)
    # 0.26 deg and 0.5 deg/h, against 0.0036 deg/h by the filter
    assert (situation.code, situation.hours_to_limit) == ("towards_limit", pytest.approx(0.28))
    of_axis = motion(newest, rate=rate)
    assert (of_axis.rate_deg_h, of_axis.hours_to_limit) == (situation.rate_deg_h, situation.hours_to_limit)
    assert found(newest).code == "known"


def test_a_slope_needs_ten_minutes_of_rows_that_gave_an_attitude():
    rows = minutes(31, lambda hours: 0.5 * hours)
    assert recent_rate([]) is None
    assert recent_rate(rows[:10]) is None
    assert recent_rate(rows[:11]) is not None
    elsewhere = [replace(row, alignment_id=7, attitude_deg=Axes(0.3, 0.05, 0.4)) for row in rows]
    assert recent_rate([*rows[:15], *elsewhere[15:]]) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    lost = [replace(row, status=Status.EXPIRED, attitude_deg=AWAY.attitude_deg) for row in rows[11:]]
    assert recent_rate([*rows[:11], *lost]) == recent_rate(rows[:11])


def test_yaw_is_beyond_its_limit_when_it_surely_is():
    assert found(replace(ROW, attitude_deg=Axes(0.9, 0.0, 0.0))).code == "known"
    assert found(replace(ROW, attitude_deg=Axes(1.1, 0.0, 0.0))).axis == "yaw"


def test_nothing_is_known_before_the_first_row_and_of_an_estimator_that_fails():
    assert found(None, verdict("no_attitude")).code == "no_attitude"
    assert found(replace(ROW, status=Status.INVALID, attitude_deg=NO_ANGLES)).code == "no_angles"
    failed = found(OLD, verdict("estimator_failed", "expired"))
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
    for each in situation.axes:
        # followed for a day at its rate, an axis is first at a limit after the time that is said
        met = [(side * LIMIT_DEG - each.angle_deg) / each.rate_deg_h for side in (-1, 1) if each.rate_deg_h]
        ahead = [hours for hours in met if 0.0 < hours < 24.0]
        if not each.is_beyond and abs(each.angle_deg) < LIMIT_DEG:
            assert each.hours_to_limit == pytest.approx(min(ahead, default=math.nan), nan_ok=True)
