"""One alarm: its condition, debounce, states as tables, and single steps between them."""

import math
from dataclasses import dataclass, replace
from enum import Enum, StrEnum, auto

from service.records.epoch import US_PER_S
from service.records.operations.alarms import (
    Alarm,
    AlarmChange,
    ChangeKind,
    ConditionLimits,
    Cover,
    Handling,
    Process,
    Severity,
    ValueMemory,
)


class AlarmEvent(Enum):
    """Event of the process state."""

    #: the condition has stood for its time
    RAISE = auto()
    #: it has become worse by a severity
    ESCALATE = auto()
    #: it has been gone for its time
    RETURN = auto()
    #: the same under a cover: no notice was sent, so nobody has to acknowledge
    RETURN_UNSEEN = auto()
    ACKNOWLEDGE = auto()
    CLEAR = auto()


class CoverEvent(Enum):
    """Event that covers or uncovers an alarm."""

    SHELVE = auto()
    #: by an operator or because the time is over
    UNSHELVE = auto()
    #: a declared operation is in force, or another alarm explains it
    SUPPRESS = auto()
    #: it no longer is
    RELEASE = auto()
    CLEAR = auto()


#: what each event means, for the page
MEANINGS: dict[AlarmEvent | CoverEvent, str] = {
    AlarmEvent.RAISE: "the condition has held for `on_s`",
    AlarmEvent.ESCALATE: "a higher limit has been passed for `on_s`; acknowledging the lower one does not cover it",
    AlarmEvent.RETURN: "the value has been inside the limit by the deadband for `off_s`",
    AlarmEvent.RETURN_UNSEEN: "the same while the alarm was shelved or suppressed: nobody has to acknowledge it",
    AlarmEvent.ACKNOWLEDGE: "an operator has seen it",
    AlarmEvent.CLEAR: "an operator closes it; a condition that still holds alarms again after `on_s`",
    CoverEvent.SHELVE: "an operator shelves the alarm until an instant, at most 24 h ahead",
    CoverEvent.UNSHELVE: "an operator ends the shelving, or its time is over",
    CoverEvent.SUPPRESS: "a declared operation or a standing alarm explains it",
    CoverEvent.RELEASE: "nothing explains it any longer",
}

_N, _U, _A, _R, _L = (
    Process.NORMAL,
    Process.UNACKNOWLEDGED,
    Process.ACKNOWLEDGED,
    Process.RETURNED,
    Process.LATCHED,
)


def _row(*targets: Process) -> dict[AlarmEvent, Process]:
    """Return the row of a state: targets in the order of ``AlarmEvent``."""
    return dict(zip(AlarmEvent, targets, strict=True))


PROCESS: dict[Process, dict[AlarmEvent, Process]] = {
    #         RAISE ESCALATE RETURN RETURN_UNSEEN ACKNOWLEDGE CLEAR
    _N: _row(_U, _U, _N, _N, _N, _N),
    _U: _row(_U, _U, _R, _N, _A, _N),
    _A: _row(_A, _U, _N, _N, _A, _N),
    _R: _row(_U, _U, _R, _N, _N, _N),
    _L: _row(_U, _U, _L, _L, _L, _N),
}

_NONE, _SHELVED, _SUPPRESSED = Cover.NONE, Cover.SHELVED, Cover.SUPPRESSED
#: shelving is the operator's word and stands above suppression, which is found again when it ends
COVERS: dict[Cover, dict[CoverEvent, Cover]] = {
    _NONE: dict(zip(CoverEvent, (_SHELVED, _NONE, _SUPPRESSED, _NONE, _NONE), strict=True)),
    _SHELVED: dict(zip(CoverEvent, (_SHELVED, _NONE, _SHELVED, _SHELVED, _NONE), strict=True)),
    _SUPPRESSED: dict(zip(CoverEvent, (_SHELVED, _SUPPRESSED, _SUPPRESSED, _NONE, _NONE), strict=True)),
}


def next_process(process: Process, event: AlarmEvent, *, is_latching: bool) -> Process:
    """Return the state after an event; what latches ends by clearing only.

    Examples
    --------
    >>> next_process(Process.ACKNOWLEDGED, AlarmEvent.RETURN, is_latching=False).value
    'normal'
    >>> next_process(Process.ACKNOWLEDGED, AlarmEvent.RETURN, is_latching=True).value
    'latched'
    """
    target = PROCESS[process][event]
    is_ending = target is Process.NORMAL and process is not Process.NORMAL and event is not AlarmEvent.CLEAR
    return Process.LATCHED if is_ending and is_latching else target


def next_cover(cover: Cover, event: CoverEvent) -> Cover:
    """Return the cover after an event."""
    return COVERS[cover][event]


class Kind(StrEnum):
    """Comparison of a value with its limits."""

    #: alarms above the limit
    ABOVE = "above"
    #: alarms below the limit
    BELOW = "below"
    #: the value is the time for which something has been so, s; it alarms from the limit on
    LASTING = "lasting"


class Origin(StrEnum):
    """Origin of the value of a condition."""

    ROW = "every row that is neither late nor from a catch-up"
    CLOCK = "intervals of `SOO_ALARMS__CHECK_PERIOD_S` of the spacecraft's clock"
    REFERENCE = "every attitude reference near a row in time"


@dataclass(frozen=True, slots=True)
class AlarmCondition:
    """One condition."""

    name: str
    kind: Kind
    unit: str
    #: what its alarms are about: carrier, axis, link ..
    thing: str
    origin: Origin
    #: what happened, a sentence with a place for the thing and one for the value
    says: str
    next_step: str
    limits: ConditionLimits


class ConditionChange(Enum):
    """Change of a condition by a value."""

    RAISE = auto()
    ESCALATE = auto()
    RETURN = auto()


def limit_of(limits: ConditionLimits, level: int) -> float:
    """Return the threshold of a severity, NaN where it has none."""
    threshold = limits.thresholds[level - 1] if level else None
    return math.nan if threshold is None else threshold


def outermost(kind: Kind, limits: ConditionLimits) -> float | None:
    """Return the limit that is passed first, None when all are switched off."""
    stated = [threshold for threshold in limits.thresholds if threshold is not None]
    if not stated:
        return None
    return max(stated) if kind is Kind.BELOW else min(stated)


def severity_level(kind: Kind, value: float, limits: ConditionLimits) -> int:
    """Return the worst severity whose limit a value has passed, 0 for none."""
    passed = 0
    for level, threshold in enumerate(limits.thresholds, start=1):
        if threshold is not None and _is_beyond(kind, value, threshold):
            passed = level
    return passed


def poll(
    watch: ValueMemory, kind: Kind, reported: float, epoch_us: int, limits: ConditionLimits
) -> ConditionChange | None:
    """Update the memory with a value and return the change of the condition, if any.

    Parameters
    ----------
    watch : ValueMemory
        Changed in place.
    kind : Kind
        How the value is held against the limits.
    reported : float
        The value; of a condition that lasts, 1 while it holds and 0 when not. NaN = not known.
    epoch_us : int
        Instant of the value; one that lies before the newest changes nothing.
    limits : ConditionLimits
        Those in force.
    """
    if epoch_us < watch.newest_us:
        return None
    if math.isnan(reported):
        watch.pending_us, watch.gone_us = None, None
        return None
    watch.newest_us = epoch_us
    is_gone = _is_gone(kind, reported, limits)
    watch.value = _value(watch, kind, reported, epoch_us)
    verdict = _worse(watch, severity_level(kind, watch.value, limits), epoch_us, limits)
    if verdict is not None:
        return verdict
    return _better(watch, epoch_us, limits, is_gone=is_gone)


def _value(watch: ValueMemory, kind: Kind, reported: float, epoch_us: int) -> float:
    """Return the value that is held against the limits; of what lasts, the time since it began, s."""
    if kind is not Kind.LASTING:
        return reported
    if reported <= 0.0:
        if watch.level == 0:
            watch.since_us = None
        return -1.0
    if watch.since_us is None:
        watch.since_us = epoch_us
    return (epoch_us - watch.since_us) / US_PER_S


def _worse(watch: ValueMemory, level: int, epoch_us: int, limits: ConditionLimits) -> ConditionChange | None:
    """Take in a severity; a verdict when one above the alarmed one has stood for its time."""
    if level <= watch.level:
        watch.pending_us = None
        return None
    watch.gone_us = None
    if watch.pending_us is None:
        watch.pending_us, watch.pending_level = epoch_us, level
    watch.pending_level = min(watch.pending_level, level)
    if epoch_us - watch.pending_us < limits.on_s * US_PER_S:
        return None
    verdict = ConditionChange.RAISE if watch.level == 0 else ConditionChange.ESCALATE
    watch.since_us = watch.pending_us if watch.since_us is None else watch.since_us
    watch.level, watch.pending_us = watch.pending_level, None
    return verdict


def _better(watch: ValueMemory, epoch_us: int, limits: ConditionLimits, *, is_gone: bool) -> ConditionChange | None:
    """Return the verdict when what was alarmed has been gone for its time."""
    if watch.level == 0:
        return None
    if not is_gone:
        watch.gone_us = None
        return None
    if watch.gone_us is None:
        watch.gone_us = epoch_us
    if epoch_us - watch.gone_us < limits.off_s * US_PER_S:
        return None
    watch.level, watch.since_us, watch.gone_us = 0, None, None
    return ConditionChange.RETURN


def _is_gone(kind: Kind, reported: float, limits: ConditionLimits) -> bool:
    """Return whether a value lies inside every limit by the deadband."""
    bound = outermost(kind, limits)
    if bound is None:
        return True
    if kind is Kind.LASTING:
        return reported <= 0.0
    if kind is Kind.BELOW:
        return reported >= bound + limits.deadband
    # values above limits are sizes: a deadband wider than the limit still lets nothing at all count as gone
    return reported <= (max(bound - limits.deadband, 0.0) if bound >= 0.0 else bound - limits.deadband)


def _is_beyond(kind: Kind, value: float, threshold: float) -> bool:
    if kind is Kind.LASTING:
        return value >= threshold
    return value < threshold if kind is Kind.BELOW else value > threshold


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
        value_at_us=at_us,
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
        value_at_us=at_us,
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
