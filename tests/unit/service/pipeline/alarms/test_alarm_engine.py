"""Alarms: readings, limit sets, debounce and states."""

import math
from dataclasses import replace

import numpy as np
import pytest

from docs.reference_pages import alarm_diagram
from service.pipeline.alarms.alarm_engine import AlarmEngine, Readings
from service.pipeline.alarms.conditions import (
    DEFAULT_SETS,
    SETS,
    AlarmContext,
    condition_table,
    context,
    faults_of,
    limits_in_force,
)
from service.pipeline.alarms.states import (
    COVERS,
    PROCESS,
    AlarmCondition,
    AlarmEvent,
    ConditionChange,
    CoverEvent,
    Kind,
    Origin,
    described,
    limit_of,
    next_cover,
    next_process,
    outermost,
    poll,
    severity_level,
)
from service.pipeline.config import AlarmConfig, RobustConfig
from service.records.catalogue import Carrier, CarrierPlan
from service.records.inputs import Operation
from service.records.operations.alarms import (
    AlarmLimits,
    ChangeKind,
    ConditionLimits,
    Cover,
    EngineMemory,
    Handling,
    Process,
    Severity,
    ValueMemory,
)

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
        ("rows_missing", "sa-1", 12.0, 0.0, "missing from source sa-1 in the last hour: 12 rows"),
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
    dark = replace(stated, sets={"eclipse": {"carrier_level": {"warning": None, "critical": None}}})
    engine.use_limits(dark)
    engine.enter(AlarmContext(("normal", "eclipse")), 60 * S)
    report(engine, 1, 0.0, 7.0)
    assert kinds(report(engine, 2, 0.0, 7.0)) == [ChangeKind.RETURNED]


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


TABLE = condition_table(AlarmConfig(), RobustConfig())
PLAN = CarrierPlan(1, "sha", tuple(Carrier(f"c{k}", "Ku", f"t{k // 2}", 11e9, 1e6) for k in range(4)))


def at(epoch_us, *operations):
    return context(operations, PLAN, epoch_us)


def test_nothing_declared_is_the_normal_set():
    assert at(5) == AlarmContext()


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("station_keeping", "manoeuvre"),
        ("momentum_unloading", "manoeuvre"),
        ("calibration_turn", "manoeuvre"),
        ("eclipse", "eclipse"),
    ],
)
def test_a_set_is_in_force_from_the_start_of_its_operation_to_its_end(kind, name):
    operation = Operation(1, kind, 10, 20)
    assert [name in at(epoch_us, operation).sets for epoch_us in (9, 10, 19, 20)] == [False, True, True, False]
    assert (at(9, operation).until_us, at(15, operation)[2:], at(25, operation).since_us) == (10, (10, 20), 20)


def test_an_operation_without_an_end_goes_on():
    assert at(1 << 50, Operation(1, "eclipse", 10, None)).sets == ("normal", "eclipse")


def test_sets_in_force_together_stand_in_their_order():
    both = (Operation(1, "station_keeping", 0, 9), Operation(2, "eclipse", 0, 9))
    assert at(5, *both).sets == SETS


@pytest.mark.parametrize("kind", ["carrier_work", "sun_outage", "gain_change", "receive_chain_work"])
def test_work_keeps_quiet_what_it_names(kind):
    named = Operation(1, kind, 0, 9, carriers=("c0",), transponders=("t1",))
    assert at(5, named).quiet_carriers == {"c0", "c2", "c3"}
    assert at(5, Operation(1, kind, 0, 9)).quiet_carriers == set(PLAN.carrier_ids)
    assert at(9, named).quiet_carriers == frozenset()
    holds = at(5, named)
    assert holds.is_quiet("carrier_absent", "c0")
    assert not holds.is_quiet("carrier_absent", "c1")
    assert not holds.is_quiet("attitude_angle", "c0")


def test_a_manoeuvre_widens_the_angles_and_quietens_what_it_disturbs():
    limits = limits_in_force(TABLE, AlarmLimits(), ("normal", "manoeuvre"))
    assert (limits["attitude_angle"].warning, limits["attitude_angle"].critical) == (0.5, 0.8)
    assert limits["methods_disagree"].suppressed
    assert limits["carrier_absent"] == TABLE["carrier_absent"].limits


def test_what_is_stated_prevails_over_the_default_of_its_set_and_under_that_of_a_later_one():
    stated = AlarmLimits(1, sets={"normal": {"carrier_level": {"warning": 1.0, "deadband": 0.1}}})
    normal = limits_in_force(TABLE, stated, ("normal",))["carrier_level"]
    dark = limits_in_force(TABLE, stated, ("normal", "eclipse"))["carrier_level"]
    assert (normal.warning, normal.distress, normal.deadband) == (1.0, 6.0, 0.1)
    assert (dark.warning, dark.distress, dark.deadband) == (5.0, 8.0, 0.1)


def test_the_sets_by_default_are_in_order():
    assert set(DEFAULT_SETS) == set(SETS)
    assert faults_of(TABLE, AlarmLimits(sets={name: dict(each) for name, each in DEFAULT_SETS.items()})) == ()


def test_faults_name_the_condition_and_what_is_wrong():
    sets = {
        "normal": {"carrier_level": {"warning": 7.0}, "carrier_c_n0": {"distress": 8.0}, "nonsense": {}},
        "eclipse": {"carrier_level": {"warning": 20.0}, "carrier_absent": {"warning": None}},
    }
    faults = faults_of(TABLE, AlarmLimits(sets=sets))
    assert [(fault.pointer, fault.code) for fault in faults] == [
        ("/sets/normal/carrier_level", "alarm_limits.order"),
        ("/sets/normal/carrier_c_n0", "alarm_limits.order"),
        ("/sets/normal/nonsense", "alarm_limits.condition"),
        ("/sets/eclipse/carrier_level", "alarm_limits.order"),
    ]


def test_every_state_answers_every_event():
    assert set(PROCESS) == set(Process)
    assert all(set(row) == set(AlarmEvent) for row in PROCESS.values())
    assert set(COVERS) == set(Cover)
    assert all(set(row) == set(CoverEvent) for row in COVERS.values())


def test_what_latches_waits_for_its_clearing():
    for order in (
        (AlarmEvent.ACKNOWLEDGE, AlarmEvent.RETURN),
        (AlarmEvent.RETURN, AlarmEvent.ACKNOWLEDGE),
        (AlarmEvent.RETURN_UNSEEN,),
    ):
        state = Process.UNACKNOWLEDGED
        for event in order:
            state = next_process(state, event, is_latching=True)
        assert state is Process.LATCHED
    assert next_process(Process.NORMAL, AlarmEvent.RETURN, is_latching=True) is Process.NORMAL


def test_what_nobody_was_told_of_needs_no_acknowledgement():
    assert PROCESS[Process.UNACKNOWLEDGED][AlarmEvent.RETURN] is Process.RETURNED
    assert PROCESS[Process.UNACKNOWLEDGED][AlarmEvent.RETURN_UNSEEN] is Process.NORMAL


def test_shelving_stands_above_suppression():
    assert next_cover(Cover.SUPPRESSED, CoverEvent.SHELVE) is Cover.SHELVED
    assert next_cover(Cover.SHELVED, CoverEvent.SUPPRESS) is Cover.SHELVED
    assert next_cover(Cover.SHELVED, CoverEvent.RELEASE) is Cover.SHELVED
    assert next_cover(Cover.SUPPRESSED, CoverEvent.UNSHELVE) is Cover.SUPPRESSED


def test_the_diagram_draws_every_change_of_state_once():
    drawn = alarm_diagram()
    for state, row in PROCESS.items():
        for target in set(row.values()) - {state}:
            names = ", ".join(event.name for event in AlarmEvent if row[event] is target)
            assert drawn.count(f"    {state.value} --> {target.value}: {names}\n") == 1
    assert "acknowledged --> latched: RETURN, RETURN_UNSEEN (where it latches)" in drawn
    assert "none --> shelved: SHELVE" in drawn


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
