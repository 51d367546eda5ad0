"""The alarms of one spacecraft: readings, time and operators in, changes out. No clock, no storage, no surprise.

Only what is not as it should be is remembered: values inside their limits cost one comparison of an array.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from service.pipeline.alarms import states as steps
from service.pipeline.alarms.conditions import AlarmContext, limits_in_force
from service.pipeline.alarms.states import (
    AlarmCondition,
    AlarmEvent,
    ConditionChange,
    CoverEvent,
    Kind,
    outermost,
    poll,
)
from service.records.epoch import US_PER_S
from service.records.levels.attitude import FloatArray
from service.records.operations.alarms import (
    Alarm,
    AlarmChange,
    AlarmLimits,
    ChangeKind,
    ConditionLimits,
    Cover,
    EngineMemory,
    Handling,
    Process,
    ValueMemory,
    WatchMemory,
)

Key = tuple[str, str]
_NO_NOTES: Mapping[str, str] = {}
#: sigmas that a cause may leave of a value, and of one that was told as an alarm of its own
MOST_SIGMAS, _ADOPTION_SIGMAS = 3.0, 2.0
#: an alarm that was told follows from a cause after so long, s
_ADOPTION_S = 120.0
#: what follows is an alarm of its own when its cause has left it unexplained, or is gone, for so long: means are slow
RELEASE_S, TAIL_S = 300.0, 600.0


class Explanation(NamedTuple):
    """Alarm that explains a value."""

    cause: Key
    #: what it leaves of the value, in sigmas; NaN = not known
    sigmas: float = 0.0


_NO_CAUSES: Mapping[str, Explanation] = {}


class Readings(NamedTuple):
    """Values of one condition at one instant."""

    condition: str
    #: all things that there are: an alarm about another one is over
    things: Sequence[str]
    #: one a thing, NaN = not known; of a condition that lasts, 1 while it stands and 0 when not
    values: Sequence[float] | FloatArray
    #: by thing, what else there is to say
    notes: Mapping[str, str] = _NO_NOTES
    #: whether other things may exist too, of which nothing is said here
    is_partial: bool = False
    #: by thing, what explains its value if it stands
    causes: Mapping[str, Explanation] = _NO_CAUSES


@dataclass(slots=True)
class _InForce:
    """Limits of one condition, and the one that is passed first."""

    condition: AlarmCondition
    limits: ConditionLimits
    bound: float | None = field(init=False)

    def __post_init__(self) -> None:
        self.bound = outermost(self.condition.kind, self.limits) if self.limits.enabled else None

    def is_beyond(self, value: float) -> bool:
        """Return whether a value has passed a limit; one that is not known has not."""
        if self.bound is None:
            return False
        if self.condition.kind is Kind.BELOW:
            return value < self.bound
        return value > (0.0 if self.condition.kind is Kind.LASTING else self.bound)

    def suspects(self, values: Sequence[float] | FloatArray) -> list[int]:
        """Return the places of values that have passed a limit."""
        reported = values.tolist() if isinstance(values, np.ndarray) else values
        return [k for k, value in enumerate(reported) if self.is_beyond(value)]


class AlarmEngine:
    """Alarms of one spacecraft, or of the service where ``spacecraft_id`` is None.

    Parameters
    ----------
    spacecraft_id : str or None
        Whose.
    conditions : mapping
        Table of conditions by name.
    stated : AlarmLimits
        Limits that hold beside the defaults.
    alarms : sequence of Alarm
        Those that were open.
    memory : EngineMemory
        What was about to happen.
    """

    def __init__(
        self,
        spacecraft_id: str | None,
        conditions: Mapping[str, AlarmCondition],
        stated: AlarmLimits | None = None,
        alarms: Sequence[Alarm] = (),
        memory: EngineMemory | None = None,
    ) -> None:
        self._spacecraft_id = spacecraft_id
        self._conditions = conditions
        self._stated = stated or AlarmLimits()
        self._context = AlarmContext()
        self._open: dict[Key, Alarm] = {alarm.key: alarm for alarm in alarms if alarm.is_open}
        self._watches: dict[str, dict[str, ValueMemory]] = {name: {} for name in conditions}
        self._in_force = self._limits()
        self._recall(memory or EngineMemory())

    @property
    def open_alarms(self) -> Mapping[Key, Alarm]:
        """Alarms that stand, by condition and thing."""
        return self._open

    @property
    def context(self) -> AlarmContext:
        """Return the context of alarms in force."""
        return self._context

    def watches(self) -> tuple[WatchMemory, ...]:
        """Return the memory of the conditions, for the next start; the next row brings the newest values."""
        fresh = ValueMemory()
        return tuple(
            WatchMemory(condition, thing, replace(watch, value=fresh.value, newest_us=fresh.newest_us))
            for condition, memories in self._watches.items()
            for thing, watch in memories.items()
        )

    def present_value(self, key: Key) -> tuple[float, int | None]:
        """Return the newest value of what is watched and its epoch, NaN and None where it is not."""
        watch = self._watch(key)
        return (float("nan"), None) if watch is None or math.isnan(watch.value) else (watch.value, watch.newest_us)

    def stands(self, key: Key) -> bool:
        """Return whether an alarm can explain others: it is active, or about to be, and no other explains it."""
        watch = self._watch(key)
        return watch is not None and not watch.is_idle and watch.cause is None

    def bound(self, condition: str) -> float:
        """Return the limit of a condition that is passed first, NaN where none is in force."""
        bound = self._in_force[condition].bound
        return float("nan") if bound is None else bound

    def adopt(self, alarm: Alarm) -> None:
        """Take over the id that the archive gave an alarm."""
        here = self._open.get(alarm.key)
        if here is not None and here.id == 0:
            self._open[alarm.key] = replace(here, id=alarm.id)

    def use_limits(self, stated: AlarmLimits) -> None:
        """Hold values against other limits from now on."""
        self._stated = stated
        self._in_force = self._limits()

    def enter(self, context: AlarmContext, at_us: int) -> list[AlarmChange]:
        """Take over what holds now; alarms are suppressed and released by it."""
        if context.sets != self._context.sets:
            self._context = context
            self._in_force = self._limits()
        self._context = context
        return [change for key in list(self._open) for change in self._covered(key, at_us)]

    def is_settled(self, condition: str, extreme: float) -> bool:
        """Return whether values need no look: nothing is remembered, and the extreme one has passed no limit."""
        return not self._watches[condition] and not self._in_force[condition].is_beyond(extreme)

    def observe(self, readings: Readings, at_us: int) -> list[AlarmChange]:
        """Hold values against the limits in force and return what changes."""
        in_force, memories = self._in_force[readings.condition], self._watches[readings.condition]
        positions = in_force.suspects(readings.values)
        if not positions and not memories:
            return []
        positions_of = {thing: k for k, thing in enumerate(readings.things)}
        suspected = [readings.things[k] for k in positions]
        concerned = dict.fromkeys([*suspected, *(readings.things if readings.is_partial else memories)])
        changes = []
        for thing in concerned:
            watch = memories.setdefault(thing, ValueMemory())
            position = positions_of.get(thing)
            if position is None or not in_force.limits.enabled:
                changes += self._over(watch, (readings.condition, thing), at_us)
            else:
                self._attribute(watch, readings.causes.get(thing), in_force.limits, at_us)
                changes += self._covered((readings.condition, thing), at_us)
                verdict = poll(watch, in_force.condition.kind, float(readings.values[position]), at_us, in_force.limits)
                if verdict is not None:
                    changes += self._judged(verdict, in_force, thing, at_us, readings.notes.get(thing, ""))
            if watch.is_idle:
                del memories[thing]
        return changes

    def pass_time(self, at_us: int) -> list[AlarmChange]:
        """End shelvings whose time is over, tell again what nobody acted on, let go of what no cause explains."""
        changes = []
        for key in list(self._open):
            watch = self._watch(key)
            if watch is not None and watch.cause is not None and not self.stands(watch.cause):
                self._attribute(watch, None, self._in_force[key[0]].limits, at_us)
                changes += self._covered(key, at_us)
        for alarm in list(self._open.values()):
            if alarm.cover is Cover.SHELVED and at_us >= (alarm.shelved_until_us or 0):
                changes.append(self._uncover(alarm, at_us, None))
            elif self._is_to_repeat(alarm, at_us):
                changes.append(self._put(ChangeKind.REPEATED, alarm, replace(alarm, changed_at_us=at_us), at_us))
        return changes

    def acknowledge(self, key: Key, handling: Handling) -> AlarmChange:
        """Note that an operator has seen an alarm."""
        alarm = self._open[key]
        after = steps.acknowledged(alarm, handling, is_latching=self._in_force[key[0]].limits.latching)
        return self._put(ChangeKind.ACKNOWLEDGED, alarm, after, handling.at_us, handling)

    def shelve(self, key: Key, handling: Handling, until_us: int) -> AlarmChange:
        """Keep an alarm quiet until an instant."""
        alarm = self._open[key]
        return self._put(ChangeKind.SHELVED, alarm, steps.shelved(alarm, handling, until_us), handling.at_us, handling)

    def unshelve(self, key: Key, handling: Handling) -> AlarmChange:
        """End a shelving before its time."""
        return self._uncover(self._open[key], handling.at_us, handling)

    def clear(self, key: Key, handling: Handling) -> AlarmChange:
        """Close an alarm; a condition that still stands is watched again."""
        self._watches[key[0]].pop(key[1], None)
        alarm = self._open[key]
        return self._put(ChangeKind.CLEARED, alarm, steps.cleared(alarm, handling), handling.at_us, handling)

    def _judged(
        self, verdict: ConditionChange, in_force: _InForce, thing: str, at_us: int, note: str
    ) -> list[AlarmChange]:
        """Carry out the verdict on one value."""
        condition, limits = in_force.condition, in_force.limits
        watch, before = self._watches[condition.name][thing], self._open.get((condition.name, thing))
        if verdict is ConditionChange.RETURN:
            return [] if before is None else [self._return(before, at_us, is_latching=limits.latching)]
        if before is None:
            after = steps.raised(self._spacecraft_id, condition, thing, watch, limits, at_us)
        else:
            event = AlarmEvent.RAISE if verdict is ConditionChange.RAISE else AlarmEvent.ESCALATE
            after = steps.again(before, watch, limits, event, at_us)
        after = steps.described(after, condition, note)
        if self._is_quiet(after.key) and after.cover is Cover.NONE:
            after = steps.covered(after, CoverEvent.SUPPRESS, at_us)
        kind = ChangeKind.ESCALATED if verdict is ConditionChange.ESCALATE else ChangeKind.RAISED
        return [self._put(kind, before, after, at_us)]

    def _return(self, alarm: Alarm, at_us: int, *, is_latching: bool) -> AlarmChange:
        """Carry out that a condition is gone."""
        # what only followed needs nobody to clear it
        after = steps.returned(alarm, at_us, is_latching=is_latching and alarm.cause is None)
        return self._put(ChangeKind.RETURNED, alarm, after, at_us)

    def _over(self, watch: ValueMemory, key: Key, at_us: int) -> list[AlarmChange]:
        """Forget a thing that is gone, or that is no longer looked at."""
        was_alarmed = watch.level > 0
        watch.level, watch.since_us, watch.pending_us = 0, None, None
        before = self._open.get(key)
        return [self._return(before, at_us, is_latching=False)] if was_alarmed and before is not None else []

    def _uncover(self, alarm: Alarm, at_us: int, handling: Handling | None) -> AlarmChange:
        """End a shelving; where an operation or a cause is in force, suppression takes its place."""
        after = steps.covered(alarm, CoverEvent.UNSHELVE, at_us)
        if self._is_quiet(alarm.key) and after.process is not Process.NORMAL:
            after = steps.covered(after, CoverEvent.SUPPRESS, at_us)
        return self._put(ChangeKind.UNSHELVED, alarm, after, at_us, handling)

    def _attribute(
        self, watch: ValueMemory, explanation: Explanation | None, limits: ConditionLimits, at_us: int
    ) -> None:
        """Note what explains a value: at once while nothing was alarmed, later when it has held for its time."""
        cause = None
        if explanation is not None and self.stands(explanation.cause):
            most = _ADOPTION_SIGMAS if watch.level and watch.cause is None else MOST_SIGMAS
            if math.isnan(explanation.sigmas):
                cause = watch.cause
            elif explanation.sigmas <= most:
                cause = explanation.cause
                if watch.cause == cause and explanation.sigmas > _ADOPTION_SIGMAS:
                    # a value is noisy: its time unexplained does not begin again with every row
                    return
        if cause == watch.cause or (cause is None and watch.gone_us is not None):
            watch.other_us = None
            return
        watch.other_us = at_us if watch.other_us is None else watch.other_us
        after_s = _ADOPTION_S
        if watch.cause is not None:
            after_s = max(limits.on_s, RELEASE_S) if self.stands(watch.cause) else TAIL_S
        if watch.level == 0 or at_us - watch.other_us >= after_s * US_PER_S:
            watch.cause, watch.other_us = cause, None

    def _covered(self, key: Key, at_us: int) -> list[AlarmChange]:
        """Suppress or release an alarm by what is in force now."""
        alarm = self._open.get(key)
        if alarm is None:
            return []
        is_quiet, is_suppressed = self._is_quiet(key), alarm.cover is Cover.SUPPRESSED
        if is_quiet and (alarm.cover is Cover.NONE or (is_suppressed and alarm.cause != self._cause_of(alarm))):
            event, kind = CoverEvent.SUPPRESS, ChangeKind.SUPPRESSED
        elif not is_quiet and is_suppressed:
            event, kind = CoverEvent.RELEASE, ChangeKind.RELEASED
        else:
            return []
        return [self._put(kind, alarm, steps.covered(alarm, event, at_us), at_us)]

    def _cause_of(self, alarm: Alarm) -> Key | None:
        """Return what explains an alarm; of one whose condition is gone, what did."""
        watch = self._watch(alarm.key)
        return watch.cause if watch is not None and alarm.is_active else alarm.cause

    def _watch(self, key: Key) -> ValueMemory | None:
        """Return the memory of a value, None where there is nothing to remember."""
        return self._watches.get(key[0], {}).get(key[1])

    def _put(
        self, kind: ChangeKind, before: Alarm | None, after: Alarm, at_us: int, handling: Handling | None = None
    ) -> AlarmChange:
        """Remember an alarm as it is after a step, or forget one that is closed."""
        after = replace(after, cause=self._cause_of(after))
        change = steps.change_of(kind, before, after, at_us, handling)
        if change.alarm.is_open:
            self._open[after.key] = change.alarm
        else:
            self._open.pop(after.key, None)
        return change

    def _is_quiet(self, key: Key) -> bool:
        """Return whether an operation or a cause keeps an alarm quiet."""
        watch = self._watch(key)
        is_explained = watch is not None and watch.cause is not None
        return is_explained or self._in_force[key[0]].limits.suppressed or self._context.is_quiet(*key)

    def _is_to_repeat(self, alarm: Alarm, at_us: int) -> bool:
        """Return whether nobody has acted on an alarm for too long."""
        repeat_s = self._in_force[alarm.condition].limits.repeat_s
        is_unattended = alarm.process is Process.UNACKNOWLEDGED and alarm.cover is Cover.NONE
        reported_us = alarm.announced_at_us or alarm.raised_at_us
        return repeat_s is not None and is_unattended and at_us - reported_us >= repeat_s * US_PER_S

    def _limits(self) -> dict[str, _InForce]:
        limits = limits_in_force(self._conditions, self._stated, self._context.sets)
        return {name: _InForce(condition, limits[name]) for name, condition in self._conditions.items()}

    def _recall(self, memory: EngineMemory) -> None:
        """Take over what was watched; where it says otherwise than the open alarms, these are right."""
        for kept in memory.watches:
            if kept.condition in self._watches:
                is_alarmed = (kept.condition, kept.thing) in self._active()
                watch = replace(kept.watch, level=kept.watch.level if is_alarmed else 0)
                self._watches[kept.condition][kept.thing] = watch
        for key in self._active():
            alarm = self._open[key]
            watch = self._watches[key[0]].setdefault(key[1], ValueMemory())
            watch.level = max(watch.level, int(alarm.severity) if watch.level == 0 else watch.level)
            watch.since_us = alarm.since_us if watch.since_us is None else watch.since_us
            watch.cause = alarm.cause

    def _active(self) -> set[Key]:
        """Return the open alarms whose condition stands."""
        return {key for key, alarm in self._open.items() if alarm.is_active and key[0] in self._conditions}
