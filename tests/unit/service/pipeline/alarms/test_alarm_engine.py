"""The alarms of one spacecraft: raised, told, covered, remembered."""

from dataclasses import replace

import numpy as np
import pytest

from service.pipeline.alarms.alarm_engine import AlarmEngine, Readings
from service.pipeline.alarms.condition import AlarmCondition, Kind, Origin
from service.pipeline.alarms.conditions import condition_table
from service.pipeline.alarms.limit_sets import AlarmContext
from service.pipeline.alarms.transitions import described
from service.pipeline.config import AlarmConfig, RobustConfig
from service.records.operations.alarm import ChangeKind, Cover, Handling, Process, Severity
from service.records.operations.alarm_limits import AlarmLimits, ConditionLimits
from service.records.operations.alarm_memory import EngineMemory

S = 1_000_000
CONDITION = AlarmCondition(
    "carrier_level",
    Kind.ABOVE,
    "dB",
    "carrier",
    Origin.ROW,
    "level of carrier {thing} differs by {value}",
    "look",
    ConditionLimits(warning=3.0, critical=6.0, deadband=0.5, on_s=60.0, off_s=60.0, repeat_s=600.0),
)
CONDITIONS = {CONDITION.name: CONDITION}
THINGS = ("c0", "c1")
KEY = ("carrier_level", "c0")


def report(engine, minute, *values, things=THINGS, **more):
    """Tell values of a minute and return what changes."""
    readings = Readings("carrier_level", things, np.array(values), **more)
    return engine.observe(readings, minute * 60 * S)


def kinds(changes):
    return [change.kind for change in changes]


def by(name="anna", minute=10):
    return Handling(name, minute * 60 * S)


@pytest.fixture
def engine():
    return AlarmEngine("craft", CONDITIONS)


@pytest.fixture
def raised(engine):
    """A book with an alarm about the first carrier, raised at minute 1."""
    assert report(engine, 0, 4.0, 0.0) == []
    (change,) = report(engine, 1, 4.25, 0.0, notes={"c0": "rain"})
    assert change.is_told
    return engine


def test_an_alarm_says_what_happened_to_which_thing_since_when_and_by_how_much(raised):
    alarm = raised.open_alarms[KEY]
    assert (alarm.process, alarm.severity, alarm.since_us, alarm.raised_at_us) == (
        Process.UNACKNOWLEDGED,
        Severity.WARNING,
        0,
        60 * S,
    )
    assert (alarm.value, alarm.limit, alarm.unit, alarm.announced_at_us) == (4.25, 3.0, "dB", 60 * S)
    assert alarm.detail == "level of carrier c0 differs by 4.2 dB, limit 3 dB; rain"


@pytest.mark.parametrize(
    ("name", "thing", "value", "limit", "words"),
    [
        ("carrier_residual", "c13", 1.906, 1.5, "residual of carrier c13 is 1.9 dB, limit 1.5 dB"),
        ("control_tripped", "stop", 120.0, 0.0, "control has tripped: stop"),
        ("attitude_angle", "roll", 0.3004, 0.3, "roll angle is 0.3004 deg, limit 0.3 deg"),
        ("carrier_absent", "c01", 3600.4, 120.0, "carrier c01 has been absent for 3600 s, limit 120 s"),
        ("ephemeris_ending", "newest", -1.24, 0.0, "remaining validity of the newest ephemeris is -1.2 h, limit 0 h"),
        (
            "rows_missing",
            "sa-1",
            12.0,
            0.0,
            "missing from source sa-1 in the last hour: 12 rows",
        ),
    ],
)
def test_an_alarm_is_a_plain_sentence_with_value_and_limit(raised, name, thing, value, limit, words):
    condition = condition_table(AlarmConfig(), RobustConfig())[name]
    alarm = replace(raised.open_alarms[KEY], thing=thing, value=value, limit=limit, unit=condition.unit)
    assert described(alarm, condition, "").detail == words


def test_every_text_names_the_thing_and_the_value_once():
    for condition in condition_table(AlarmConfig(), RobustConfig()).values():
        # that control has tripped matters, not for how long
        values = condition.name != "control_tripped"
        assert (condition.says.count("{thing}"), condition.says.count("{value}")) == (1, values), condition.name


def test_each_thing_has_an_alarm_of_its_own(engine):
    report(engine, 0, 4.0, 7.0)
    changes = report(engine, 1, 4.0, 7.0)
    assert [(change.alarm.thing, change.alarm.severity.word) for change in changes] == [
        ("c0", "warning"),
        ("c1", "critical"),
    ]


def test_a_worse_alarm_must_be_acknowledged_again(raised):
    raised.acknowledge(KEY, by())
    report(raised, 11, 7.0, 0.0)
    (change,) = report(raised, 12, 7.0, 0.0)
    assert (change.kind, change.is_told) == (ChangeKind.ESCALATED, True)
    assert (change.alarm.process, change.alarm.severity) == (Process.UNACKNOWLEDGED, Severity.CRITICAL)
    assert (change.alarm.value, change.alarm.limit, change.alarm.since_us) == (7.0, 6.0, 0)
    assert change.alarm.acknowledged == by()


def test_what_returns_unseen_waits_for_its_acknowledgement_and_the_same_alarm_comes_back(raised):
    report(raised, 2, 0.0, 0.0)
    (change,) = report(raised, 3, 0.0, 0.0)
    assert (change.kind, change.alarm.process, change.alarm.returned_at_us) == (
        ChangeKind.RETURNED,
        Process.RETURNED,
        180 * S,
    )
    report(raised, 4, 4.0, 0.0)
    (back,) = report(raised, 5, 4.0, 0.0)
    assert (back.kind, back.alarm.process, back.alarm.count) == (ChangeKind.RAISED, Process.UNACKNOWLEDGED, 2)
    assert (back.alarm.since_us, back.alarm.raised_at_us, back.alarm.returned_at_us) == (240 * S, 60 * S, None)


def test_an_acknowledged_alarm_closes_when_the_condition_is_gone(raised):
    raised.acknowledge(KEY, by())
    report(raised, 11, 0.0, 0.0)
    (change,) = report(raised, 12, 0.0, 0.0)
    assert (change.alarm.process, change.alarm.is_open) == (Process.NORMAL, False)
    assert KEY not in raised.open_alarms
    assert raised.watches() == ()


def test_nobody_is_told_of_a_shelved_alarm_until_its_time_is_over(raised):
    shelved = raised.shelve(KEY, by(), 60 * 60 * S)
    assert (shelved.alarm.state, shelved.is_told) == ("shelved", False)
    report(raised, 11, 7.0, 0.0)
    (worse,) = report(raised, 12, 7.0, 0.0)
    assert (worse.kind, worse.is_told, worse.alarm.state) == (ChangeKind.ESCALATED, False, "shelved")
    assert raised.pass_time(59 * 60 * S) == []
    (back,) = raised.pass_time(60 * 60 * S)
    assert (back.kind, back.is_told, back.alarm.state) == (ChangeKind.UNSHELVED, True, "unacknowledged")
    assert back.alarm.shelved_until_us is None


def test_a_shelved_alarm_that_is_gone_stays_shelved_and_closes_with_its_time(raised):
    raised.shelve(KEY, by(), 60 * 60 * S)
    report(raised, 11, 0.0, 0.0)
    (gone,) = report(raised, 12, 0.0, 0.0)
    assert (gone.alarm.process, gone.alarm.state, gone.is_told) == (Process.NORMAL, "shelved", False)
    report(raised, 13, 4.0, 0.0)
    (again,) = report(raised, 14, 4.0, 0.0)
    assert (again.is_told, again.alarm.count) == (False, 2)
    report(raised, 15, 0.0, 0.0)
    report(raised, 16, 0.0, 0.0)
    (closed,) = raised.pass_time(60 * 60 * S)
    assert (closed.alarm.is_open, closed.is_told) == (False, False)


def test_an_acknowledgement_outlives_shelving(raised):
    raised.acknowledge(KEY, by())
    raised.shelve(KEY, by(), 60 * 60 * S)
    (back,) = raised.pass_time(60 * 60 * S)
    assert (back.alarm.state, back.is_told) == ("acknowledged", False)


def test_an_operator_ends_a_shelving(raised):
    raised.shelve(KEY, by(), 60 * 60 * S)
    change = raised.unshelve(KEY, by("boris"))
    assert (change.handling, change.alarm.state, change.is_told) == (by("boris"), "unacknowledged", True)


def test_what_is_cleared_while_it_stands_alarms_anew_after_its_time(raised):
    change = raised.clear(KEY, by())
    assert (change.alarm.is_open, change.alarm.cleared) == (False, by())
    assert report(raised, 11, 4.0, 0.0) == []
    (new,) = report(raised, 12, 4.0, 0.0)
    assert (new.kind, new.alarm.count, new.alarm.raised_at_us) == (ChangeKind.RAISED, 1, 720 * S)


def test_nobody_is_told_of_the_clearing_of_a_shelved_alarm(raised):
    raised.shelve(KEY, by(), 60 * 60 * S)
    change = raised.clear(KEY, by())
    assert (change.is_told, change.alarm.is_open) == (False, False)


def test_what_nobody_acts_on_is_told_again(raised):
    assert raised.pass_time(10 * 60 * S) == []
    (first,) = raised.pass_time(11 * 60 * S)
    assert (first.kind, first.is_told, first.alarm.repeats) == (ChangeKind.REPEATED, True, 1)
    assert raised.pass_time(12 * 60 * S) == []
    raised.acknowledge(KEY, by())
    assert raised.pass_time(1000 * 60 * S) == []


def test_a_declared_operation_suppresses_what_stands_and_what_comes(raised):
    quiet = AlarmContext(quiet_carriers=frozenset(THINGS))
    (change,) = raised.enter(quiet, 120 * S)
    assert (change.kind, change.alarm.state, change.is_told) == (ChangeKind.SUPPRESSED, "suppressed", False)
    report(raised, 3, 4.0, 4.0)
    (new,) = report(raised, 4, 4.0, 4.0)
    assert (new.alarm.thing, new.alarm.state, new.is_told) == ("c1", "suppressed", False)
    assert raised.pass_time(1000 * 60 * S) == []
    released = raised.enter(AlarmContext(), 1001 * 60 * S)
    assert [(one.alarm.thing, one.alarm.state, one.is_told) for one in released] == [
        ("c0", "unacknowledged", True),
        ("c1", "unacknowledged", True),
    ]


def test_what_is_gone_while_it_was_suppressed_is_closed(raised):
    raised.enter(AlarmContext(quiet_carriers=frozenset(THINGS)), 120 * S)
    report(raised, 3, 0.0, 0.0)
    (gone,) = report(raised, 4, 0.0, 0.0)
    assert (gone.alarm.is_open, gone.is_told) == (False, False)


def test_a_shelving_that_ends_during_an_operation_leaves_the_alarm_quiet(raised):
    raised.shelve(KEY, by(), 60 * 60 * S)
    assert raised.enter(AlarmContext(quiet_carriers=frozenset(THINGS)), 120 * S) == []
    (change,) = raised.pass_time(60 * 60 * S)
    assert (change.alarm.state, change.is_told) == ("suppressed", False)


def test_a_thing_that_is_gone_ends_its_alarm_and_one_of_which_nothing_is_said_does_not(raised):
    assert report(raised, 2, 0.0, things=("c1",), is_partial=True) == []
    (change,) = report(raised, 2, 0.0, things=("c1",))
    assert (change.kind, change.alarm.process) == (ChangeKind.RETURNED, Process.RETURNED)


def test_stated_limits_and_sets_change_what_alarms(engine):
    stated = AlarmLimits(1, sets={"normal": {"carrier_level": {"warning": 1.0, "on_s": 0.0}}})
    engine.use_limits(stated)
    assert kinds(report(engine, 0, 1.5, 0.0)) == [ChangeKind.RAISED]
    rain = replace(stated, sets={"rain": {"carrier_level": {"warning": None, "critical": None}}})
    engine.use_limits(rain)
    engine.enter(AlarmContext(("normal", "rain")), 60 * S)
    report(engine, 1, 0.0, 14.0)
    assert kinds(report(engine, 2, 0.0, 14.0)) == [ChangeKind.RETURNED]


def test_a_condition_that_is_switched_off_ends_its_alarms(raised):
    raised.use_limits(AlarmLimits(1, sets={"normal": {"carrier_level": {"enabled": False}}}))
    assert kinds(report(raised, 2, 9.0, 9.0)) == [ChangeKind.RETURNED]
    assert report(raised, 9, 9.0, 9.0) == []


def test_a_restart_forgets_nothing_and_repeats_nothing(raised):
    report(raised, 2, 4.0, 4.0)
    memory = EngineMemory(raised.watches())
    after = AlarmEngine("craft", CONDITIONS, None, tuple(raised.open_alarms.values()), memory)
    assert after.pass_time(180 * S) == []
    # what was about to alarm does so after its time, what was alarmed not again
    (change,) = report(after, 3, 4.0, 4.0)
    assert change.alarm.thing == "c1"
    report(after, 4, 0.0, 4.0)
    assert kinds(report(after, 5, 0.0, 4.0)) == [ChangeKind.RETURNED]


def test_a_memory_that_was_lost_is_found_again_in_the_open_alarms(raised):
    after = AlarmEngine("craft", CONDITIONS, None, tuple(raised.open_alarms.values()))
    assert report(after, 2, 4.0, 0.0) == []
    report(after, 3, 0.0, 0.0)
    assert kinds(report(after, 4, 0.0, 0.0)) == [ChangeKind.RETURNED]
    # and one that was cleared meanwhile is not taken for alarmed
    stale = EngineMemory(raised.watches())
    fresh = AlarmEngine("craft", CONDITIONS, None, (), stale)
    report(fresh, 5, 4.0, 0.0)
    assert kinds(report(fresh, 6, 4.0, 0.0)) == [ChangeKind.RAISED]


def test_ids_are_taken_over_from_the_archive(raised):
    raised.adopt(replace(raised.open_alarms[KEY], id=17))
    assert raised.acknowledge(KEY, by()).alarm.id == 17


def test_the_conditions_by_default_have_limits_in_order_and_angles_of_the_settings():
    table = condition_table(AlarmConfig(attitude_warning_deg=0.2), RobustConfig(disagreement_deg=0.25))
    angle = table["attitude_angle"].limits
    assert (angle.warning, angle.critical) == (0.2, 0.4)
    assert table["methods_disagree"].limits.warning == 0.25
    for condition in table.values():
        stated = [limit for limit in condition.limits.thresholds if limit is not None]
        assert stated
        assert stated == sorted(stated, reverse=condition.kind is Kind.BELOW)
        assert condition.next_step
        assert Cover.NONE.value not in condition.says
