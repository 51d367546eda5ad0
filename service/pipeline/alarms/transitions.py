"""Single steps of one alarm: an event in, the alarm after it out, and whether somebody is to be told."""

from dataclasses import replace

from service.pipeline.alarms.condition import AlarmCondition, Kind
from service.pipeline.alarms.debounce import limit_of
from service.pipeline.alarms.states import AlarmEvent, CoverEvent, next_cover, next_process
from service.records.operations.alarm import Alarm, AlarmChange, ChangeKind, Cover, Handling, Process, Severity
from service.records.operations.alarm_limits import ConditionLimits
from service.records.operations.alarm_memory import ValueMemory

#: after these somebody knows of the alarm as it is
_ANNOUNCING = (
    ChangeKind.RAISED,
    ChangeKind.ESCALATED,
    ChangeKind.REPEATED,
    ChangeKind.UNSHELVED,
    ChangeKind.RELEASED,
)
#: an alarm that comes out from under a cover is told only while nobody has acknowledged it
_UNCOVERING = (ChangeKind.UNSHELVED, ChangeKind.RELEASED)
_QUIET_KINDS = (ChangeKind.SHELVED, ChangeKind.SUPPRESSED)


def raised(
    spacecraft_id: str | None,
    condition: AlarmCondition,
    thing: str,
    watch: ValueMemory,
    limits: ConditionLimits,
    at_us: int,
) -> Alarm:
    """Return the alarm that a watch has just raised, not yet told."""
    since_us = at_us if watch.since_us is None else watch.since_us
    return Alarm(
        id=0,
        spacecraft_id=spacecraft_id,
        condition=condition.name,
        thing=thing,
        process=next_process(Process.NORMAL, AlarmEvent.RAISE, is_latching=limits.latching),
        cover=Cover.NONE,
        severity=Severity(watch.level),
        since_us=since_us,
        raised_at_us=at_us,
        changed_at_us=at_us,
        value=watch.value,
        limit=limit_of(limits, watch.level),
        unit=condition.unit,
        detail="",
    )


def described(alarm: Alarm, condition: AlarmCondition, note: str) -> Alarm:
    """Return the alarm with what happened in words."""
    limit = _figure(alarm.limit, 4)
    # as few digits as tell the value from its limit
    value = next((text for text in (_figure(alarm.value, digits) for digits in (2, 3)) if text != limit), None)
    words = condition.says.format(thing=alarm.thing, value=f"{value or _figure(alarm.value, 4)} {alarm.unit}")
    if "{value}" in condition.says and (alarm.limit or condition.kind is Kind.BELOW):
        words += f", limit {limit} {alarm.unit}"
    return replace(alarm, detail=f"{words}; {note}" if note else words)


def _figure(value: float, digits: int) -> str:
    """Return a number with some digits, whole from 100 on."""
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.{digits}g}"


def again(alarm: Alarm, watch: ValueMemory, limits: ConditionLimits, event: AlarmEvent, at_us: int) -> Alarm:
    """Return an open alarm whose condition came back, or became worse."""
    is_back = event is AlarmEvent.RAISE
    return replace(
        alarm,
        process=next_process(alarm.process, event, is_latching=limits.latching),
        severity=max(alarm.severity, Severity(watch.level)),
        since_us=watch.since_us if is_back and watch.since_us is not None else alarm.since_us,
        value=watch.value,
        limit=limit_of(limits, watch.level),
        count=alarm.count + is_back,
        returned_at_us=None,
        changed_at_us=at_us,
    )


def returned(alarm: Alarm, at_us: int, *, is_latching: bool) -> Alarm:
    """Return an alarm whose condition is gone; what lay under suppression closes with it."""
    event = AlarmEvent.RETURN if alarm.cover is Cover.NONE else AlarmEvent.RETURN_UNSEEN
    process = next_process(alarm.process, event, is_latching=is_latching)
    is_closing = process is Process.NORMAL and alarm.cover is Cover.SUPPRESSED
    cover = Cover.NONE if is_closing else alarm.cover
    return replace(alarm, process=process, cover=cover, returned_at_us=at_us, changed_at_us=at_us)


def acknowledged(alarm: Alarm, handling: Handling, *, is_latching: bool) -> Alarm:
    """Return an alarm that an operator has seen."""
    process = next_process(alarm.process, AlarmEvent.ACKNOWLEDGE, is_latching=is_latching)
    return replace(alarm, process=process, acknowledged=handling, changed_at_us=handling.at_us)


def shelved(alarm: Alarm, handling: Handling, until_us: int) -> Alarm:
    """Return an alarm that is to be quiet until an instant."""
    cover = next_cover(alarm.cover, CoverEvent.SHELVE)
    return replace(alarm, cover=cover, shelved=handling, shelved_until_us=until_us, changed_at_us=handling.at_us)


def cleared(alarm: Alarm, handling: Handling) -> Alarm:
    """Return an alarm that an operator has closed."""
    return replace(
        alarm,
        process=next_process(alarm.process, AlarmEvent.CLEAR, is_latching=False),
        cover=next_cover(alarm.cover, CoverEvent.CLEAR),
        cleared=handling,
        shelved_until_us=None,
        changed_at_us=handling.at_us,
    )


def covered(alarm: Alarm, event: CoverEvent, at_us: int) -> Alarm:
    """Return an alarm after its cover was moved by time or by an operation."""
    cover = next_cover(alarm.cover, event)
    until_us = alarm.shelved_until_us if cover is Cover.SHELVED else None
    return replace(alarm, cover=cover, shelved_until_us=until_us, changed_at_us=at_us)


def change_of(
    kind: ChangeKind, before: Alarm | None, alarm: Alarm, at_us: int, handling: Handling | None
) -> AlarmChange:
    """Return a step as a change, and whether it is to be told: never what happened under a cover."""
    was_covered = before is not None and before.cover is not Cover.NONE and kind not in _UNCOVERING
    is_seen = kind not in _UNCOVERING or alarm.process is Process.UNACKNOWLEDGED
    is_told = not was_covered and alarm.cover is Cover.NONE and is_seen and kind not in _QUIET_KINDS
    if is_told and kind in _ANNOUNCING:
        alarm = replace(alarm, announced_at_us=at_us, repeats=alarm.repeats + (kind is ChangeKind.REPEATED))
    return AlarmChange(kind, alarm, at_us, is_told, handling)
