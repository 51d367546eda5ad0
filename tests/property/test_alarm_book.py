"""Whatever happens in whatever order: acknowledgements hold, covers are quiet, every alarm has a way out."""

import numpy as np
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from service.pipeline.alarms.alarm_engine import AlarmEngine, Readings
from service.pipeline.alarms.conditions import AlarmContext
from service.pipeline.alarms.states import AlarmCondition, Kind, Origin
from service.records.operations.alarms import ChangeKind, ConditionLimits, Cover, EngineMemory, Handling, Process

S = 1_000_000
THINGS = ("c0", "c1")
SHELVING_S = 300


def condition(name, *, latching):
    limits = ConditionLimits(
        warning=3.0, critical=6.0, deadband=0.5, on_s=60.0, off_s=60.0, repeat_s=240.0, latching=latching
    )
    return AlarmCondition(name, Kind.ABOVE, "dB", "carrier", Origin.ROW, "is", "look", limits)


CONDITIONS = {
    "carrier_level": condition("carrier_level", latching=False),
    "carrier_residual": condition("carrier_residual", latching=True),
}
QUIET = AlarmContext(quiet_carriers=frozenset(THINGS))
VALUE = st.sampled_from([0.0, 2.8, 4.0, 7.0, float("nan")])
STEP = st.one_of(
    st.tuples(st.just("observe"), st.sampled_from(list(CONDITIONS)), st.tuples(VALUE, VALUE)),
    st.tuples(st.sampled_from(["acknowledge", "shelve", "unshelve", "clear"]), st.integers(0, 3), st.none()),
    st.tuples(st.sampled_from(["wait", "operation", "operation_over", "restart"]), st.just(0), st.none()),
)


class Story:
    """A book that lives through steps, a minute each, and what is known of its alarms."""

    def __init__(self):
        self.engine = AlarmEngine("craft", CONDITIONS)
        self.minute = 0
        self.changes = []

    @property
    def now_us(self):
        return self.minute * 60 * S

    def do(self, step):
        self.minute += 1
        kind, what, values = step
        changes = getattr(self, f"_{kind}")(what, values)
        changes += self.engine.pass_time(self.now_us)
        self.changes += changes
        return changes

    def _observe(self, name, values):
        return self.engine.observe(Readings(name, THINGS, np.array(values)), self.now_us)

    def _wait(self, *_):
        self.minute += 10
        return []

    def _operation(self, *_):
        return self.engine.enter(QUIET, self.now_us)

    def _operation_over(self, *_):
        return self.engine.enter(AlarmContext(), self.now_us)

    def _restart(self, *_):
        holds = self.engine.context
        memory = EngineMemory(self.engine.watches())
        self.engine = AlarmEngine("craft", CONDITIONS, None, tuple(self.engine.open_alarms.values()), memory)
        return self.engine.enter(holds, self.now_us)

    def _operate(self, position, order):
        keys = sorted(self.engine.open_alarms)
        return [order(keys[position % len(keys)])] if keys else []

    def _acknowledge(self, position, _):
        return self._operate(position, lambda key: self.engine.acknowledge(key, Handling("anna", self.now_us)))

    def _clear(self, position, _):
        return self._operate(position, lambda key: self.engine.clear(key, Handling("anna", self.now_us)))

    def _shelve(self, position, _):
        until_us = self.now_us + SHELVING_S * S
        return self._operate(position, lambda key: self.engine.shelve(key, Handling("anna", self.now_us), until_us))

    def _unshelve(self, position, _):
        keys = [key for key, alarm in self.engine.open_alarms.items() if alarm.cover is Cover.SHELVED]
        return [self.engine.unshelve(key, Handling("anna", self.now_us)) for key in keys[:1]]


@settings(deadline=None, max_examples=examples(150))
@given(st.lists(STEP, max_size=40))
def test_any_story_keeps_the_promises_of_the_states(steps):
    story, before = Story(), {}
    for step in steps:
        for change in story.do(step):
            former = before.get(change.alarm.key)
            if former is not None and former.process is Process.ACKNOWLEDGED:
                is_lost = change.alarm.process is Process.UNACKNOWLEDGED
                assert not is_lost or change.kind is ChangeKind.ESCALATED
            if change.alarm.cover is not Cover.NONE:
                assert not change.is_told
            before[change.alarm.key] = change.alarm if change.alarm.is_open else None
        open_alarms = dict(story.engine.open_alarms)
        assert {key: alarm for key, alarm in before.items() if alarm is not None} == open_alarms
        assert all(alarm.is_open and alarm.key == key for key, alarm in open_alarms.items())
    _leads_out(story)


def _leads_out(story):
    """Good values, time and acknowledgements close everything; what latches wants its clearing."""
    story.do(("operation_over", 0, None))
    for _ in range(3):
        for name in CONDITIONS:
            story.do(("observe", name, (0.0, 0.0)))
        story.do(("wait", 0, None))
    for key in sorted(story.engine.open_alarms):
        story.changes.append(story.engine.acknowledge(key, Handling("anna", story.now_us)))
    assert {alarm.process for alarm in story.engine.open_alarms.values()} <= {Process.LATCHED}
    for key in sorted(story.engine.open_alarms):
        story.engine.clear(key, Handling("anna", story.now_us))
    assert story.engine.open_alarms == {}
    assert story.engine.watches() == ()


@settings(deadline=None, max_examples=examples(60))
@given(st.lists(STEP, max_size=40))
def test_a_restart_at_any_place_changes_nothing_of_what_is_told(steps):
    plain, restarted = Story(), Story()
    for step in steps:
        if step[0] == "restart":
            continue
        reported = plain.do(step)
        restarted._restart()
        assert restarted.do(step) == reported
