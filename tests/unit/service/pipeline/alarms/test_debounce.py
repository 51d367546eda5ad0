"""One watched value: what it takes to alarm, and what it takes to be over."""

import math

import pytest

from service.pipeline.alarms.condition import Kind
from service.pipeline.alarms.debounce import ConditionChange, limit_of, outermost, poll, severity_level
from service.records.operations.alarm_limits import ConditionLimits
from service.records.operations.alarm_memory import ValueMemory

S = 1_000_000
LIMITS = ConditionLimits(warning=3.0, critical=6.0, deadband=0.5, on_s=120.0, off_s=60.0)
NAN = math.nan


def run(values, limits=LIMITS, kind=Kind.ABOVE, step_s=60, watch=None):
    """Return the verdicts on values, one a minute, as (place, verdict)."""
    watch = watch or ValueMemory()
    reported = [(k, poll(watch, kind, value, k * step_s * S, limits)) for k, value in enumerate(values)]
    return [(k, verdict) for k, verdict in reported if verdict is not None]


def test_a_value_alarms_when_it_has_stood_for_its_time_and_not_before():
    assert run([4, 4]) == []
    assert run([4, 4, 4]) == [(2, ConditionChange.RAISE)]
    assert run([4, 4, 2, 4, 4]) == []


def test_the_limit_itself_is_no_alarm():
    assert run([3.0] * 10) == []
    assert run([3.0001] * 3) == [(2, ConditionChange.RAISE)]


def test_a_value_is_over_when_it_is_inside_by_the_deadband_for_its_time():
    assert run([4, 4, 4, 2.6, 2.6, 2.6]) == [(2, ConditionChange.RAISE)]
    assert run([4, 4, 4, 2.5, 2.6, 2.5, 2.5]) == [(2, ConditionChange.RAISE), (6, ConditionChange.RETURN)]


def test_a_deadband_wider_than_the_limit_leaves_a_way_back():
    wide = ConditionLimits(warning=3.0, deadband=30.0)
    assert run([4, 1, 0], wide) == [(0, ConditionChange.RAISE), (2, ConditionChange.RETURN)]


def test_a_value_that_flutters_about_its_limit_alarms_once():
    assert run([4, 4, 4] + [2.9, 3.1] * 50) == [(2, ConditionChange.RAISE)]


def test_a_worse_value_escalates_after_its_time_and_the_least_of_the_time_counts():
    watch = ValueMemory()
    assert run([4, 4, 7, 7], watch=watch) == [(2, ConditionChange.RAISE)]
    assert watch.level == 2
    assert run([4, 4, 4, 7, 7, 7]) == [(2, ConditionChange.RAISE), (5, ConditionChange.ESCALATE)]
    watch = ValueMemory()
    run([7, 7, 7], watch=watch)
    assert watch.level == 4


def test_what_is_not_known_begins_anew_and_ends_nothing():
    assert run([4, 4, NAN, 4, 4]) == []
    assert run([4, 4, 4, NAN, 2, NAN, 2, 2]) == [(2, ConditionChange.RAISE), (7, ConditionChange.RETURN)]


def test_values_of_the_past_change_nothing():
    watch = ValueMemory()
    poll(watch, Kind.ABOVE, 4, 600 * S, LIMITS)
    assert poll(watch, Kind.ABOVE, 4, 0, LIMITS) is None
    assert watch.pending_us == 600 * S


def test_below_is_above_upside_down():
    limits = ConditionLimits(warning=6.0, distress=3.0, deadband=0.5, off_s=0.0)
    assert run([7, 5.9, 2.9, 6.4, 6.5], limits, Kind.BELOW) == [
        (1, ConditionChange.RAISE),
        (2, ConditionChange.ESCALATE),
        (4, ConditionChange.RETURN),
    ]
    assert outermost(Kind.BELOW, limits) == 6.0


def test_what_lasts_alarms_by_the_time_it_has_lasted():
    limits = ConditionLimits(warning=120.0, distress=240.0, off_s=60.0)
    watch = ValueMemory()
    assert run([1, 1, 1, 1, 1], limits, Kind.LASTING, watch=watch) == [
        (2, ConditionChange.RAISE),
        (4, ConditionChange.ESCALATE),
    ]
    assert (watch.since_us, watch.value) == (0, 240.0)
    assert run([1, 0, 1, 1, 1], limits, Kind.LASTING) == [(4, ConditionChange.RAISE)]
    assert run([1, 1, 1, 0, 0], limits, Kind.LASTING) == [(2, ConditionChange.RAISE), (4, ConditionChange.RETURN)]


def test_a_limit_of_zero_seconds_alarms_at_once():
    assert run([0, 1], ConditionLimits(warning=0.0), Kind.LASTING) == [(1, ConditionChange.RAISE)]


def test_nothing_is_remembered_of_what_is_as_it_should_be():
    watch = ValueMemory()
    run([4, 4, 4, 2, 2], watch=watch)
    assert watch.is_idle
    lasting = ValueMemory()
    run([1, 0], ConditionLimits(warning=600.0), Kind.LASTING, watch=lasting)
    assert lasting.is_idle


def test_limits_that_are_switched_off_alarm_nothing_and_end_what_stands():
    off = ConditionLimits()
    assert outermost(Kind.ABOVE, off) is None
    assert run([1e9] * 5, off) == []
    assert run([0.0], off, watch=ValueMemory(level=2, since_us=0)) == [(0, ConditionChange.RETURN)]


@pytest.mark.parametrize(("value", "level"), [(2.0, 0), (3.5, 2), (6.5, 4), (NAN, 0)])
def test_the_worst_limit_passed_tells_the_severity(value, level):
    assert severity_level(Kind.ABOVE, value, LIMITS) == level


def test_the_limit_of_a_severity():
    assert limit_of(LIMITS, 4) == 6.0
    assert math.isnan(limit_of(LIMITS, 3))
    assert math.isnan(limit_of(LIMITS, 0))
