"""States of an alarm as tables, and the diagram drawn from them.

Law of this file: a change that does not stand in ``PROCESS`` or ``COVERS`` does not happen.
"""

from enum import Enum, auto

from service.records.operations.alarm import Cover, Process


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
    #: a declared operation is in force
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
    CoverEvent.SUPPRESS: "a declared operation explains the alarm",
    CoverEvent.RELEASE: "that operation is over",
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


def diagram() -> str:
    """Return both tables as a Mermaid state diagram; what stays in its state is left out."""
    lines = ["stateDiagram-v2", "    [*] --> normal"]
    for state, row in PROCESS.items():
        lines += _arrows(state.value, {event.name: target.value for event, target in row.items()})
    for state in Process:
        ends = [
            event for event in AlarmEvent if next_process(state, event, is_latching=True) is not PROCESS[state][event]
        ]
        names = ", ".join(event.name for event in ends)
        lines += [f"    {state.value} --> {Process.LATCHED.value}: {names} (where it latches)"] if names else []
    lines.append("    state cover {")
    for cover, covered in COVERS.items():
        arrows = _arrows(cover.value, {event.name: target.value for event, target in covered.items()})
        lines += [f"    {line}" for line in arrows]
    return "\n".join([*lines, "    }"])


def _arrows(state: str, targets: dict[str, str]) -> list[str]:
    """Return the arrows that leave a state."""
    leaving: dict[str, list[str]] = {}
    for event, target in targets.items():
        if target != state:
            leaving.setdefault(target, []).append(event)
    return [f"    {state} --> {target}: {', '.join(events)}" for target, events in leaving.items()]


def tables() -> str:
    """Return both tables in Markdown, and what each event means."""
    head = "| state | " + " | ".join(event.name for event in AlarmEvent) + " |\n|---|" + "---|" * len(AlarmEvent)
    rows = [f"| {state.value} | " + " | ".join(t.value for t in row.values()) + " |" for state, row in PROCESS.items()]
    cover_head = "| cover | " + " | ".join(e.name for e in CoverEvent) + " |\n|---|" + "---|" * len(CoverEvent)
    covers = [f"| {cover.value} | " + " | ".join(t.value for t in row.values()) + " |" for cover, row in COVERS.items()]
    meanings = [f"| {event.name} | {meaning} |" for event, meaning in MEANINGS.items()]
    parts = ["\n".join([head, *rows]), "\n".join([cover_head, *covers])]
    return "\n\n".join([*parts, "\n".join(["| event | meaning |", "|---|---|", *meanings])])
