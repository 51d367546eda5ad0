"""The states of an acquisition and what moves it from one to another: a table, and the page drawn from it.

Law of this file: a change of state that does not stand in `TRANSITIONS` does not happen.
"""

from enum import Enum, auto


class AcquisitionState(Enum):
    """State of the acquisition."""

    CONNECT = auto()
    IDENTIFY = auto()
    CONFIGURE = auto()
    MEASURE = auto()
    BACKOFF = auto()
    DISABLED = auto()


class AcquisitionEvent(Enum):
    """End of a state's action, or order of an operator before it."""

    OK = auto()
    FAULT = auto()
    RESET = auto()
    DISABLE = auto()
    ENABLE = auto()


#: what is done in each state
ACTIONS: dict[AcquisitionState, str] = {
    AcquisitionState.CONNECT: "open a session",
    AcquisitionState.IDENTIFY: "ask `*IDN?`, choose the driver, reset the analyzer, set detector, unit and format",
    AcquisitionState.CONFIGURE: "send the settings of the first sweep and read them back",
    AcquisitionState.MEASURE: "wait for the period, take one cycle of sweeps, hand its row over",
    AcquisitionState.BACKOFF: "close the session; wait 1, 2, 4 .. 60 s, shortened by up to a fifth at random",
    AcquisitionState.DISABLED: "rest with the session closed until an operator enables the link again",
}
#: what each event means
MEANINGS: dict[AcquisitionEvent, str] = {
    AcquisitionEvent.OK: "the action succeeded",
    AcquisitionEvent.FAULT: "no answer, a broken line, an unreadable answer, a refusal, no good row for three periods",
    AcquisitionEvent.RESET: "an operator asked for a new session; waiting times begin again",
    AcquisitionEvent.DISABLE: "an operator disabled the link",
    AcquisitionEvent.ENABLE: "an operator enabled the link",
}


def _row(
    state: AcquisitionState, on_success: AcquisitionState, on_fault: AcquisitionState = AcquisitionState.BACKOFF
) -> dict[AcquisitionEvent, AcquisitionState]:
    """Return the row of a state that works; orders mean the same in all of them."""
    return {
        AcquisitionEvent.OK: on_success,
        AcquisitionEvent.FAULT: on_fault,
        AcquisitionEvent.RESET: AcquisitionState.CONNECT,
        AcquisitionEvent.DISABLE: AcquisitionState.DISABLED,
        AcquisitionEvent.ENABLE: state,
    }


TRANSITIONS: dict[AcquisitionState, dict[AcquisitionEvent, AcquisitionState]] = {
    AcquisitionState.CONNECT: _row(AcquisitionState.CONNECT, AcquisitionState.IDENTIFY),
    AcquisitionState.IDENTIFY: _row(AcquisitionState.IDENTIFY, AcquisitionState.CONFIGURE),
    AcquisitionState.CONFIGURE: _row(AcquisitionState.CONFIGURE, AcquisitionState.MEASURE),
    AcquisitionState.MEASURE: _row(AcquisitionState.MEASURE, AcquisitionState.MEASURE),
    AcquisitionState.BACKOFF: _row(AcquisitionState.BACKOFF, AcquisitionState.CONNECT, AcquisitionState.CONNECT),
    AcquisitionState.DISABLED: {
        AcquisitionEvent.OK: AcquisitionState.DISABLED,
        AcquisitionEvent.FAULT: AcquisitionState.DISABLED,
        AcquisitionEvent.RESET: AcquisitionState.DISABLED,
        AcquisitionEvent.DISABLE: AcquisitionState.DISABLED,
        AcquisitionEvent.ENABLE: AcquisitionState.CONNECT,
    },
}


def diagram() -> str:
    """Return the table as a Mermaid state diagram; what stays in its state is left out, but for measuring."""
    lines = ["stateDiagram-v2", "    [*] --> CONNECT"]
    for state, row in TRANSITIONS.items():
        targets: dict[AcquisitionState, list[str]] = {}
        for event, target in row.items():
            if target is not state or (state is AcquisitionState.MEASURE and event is AcquisitionEvent.OK):
                targets.setdefault(target, []).append(event.name)
        lines += [f"    {state.name} --> {target.name}: {', '.join(events)}" for target, events in targets.items()]
    return "\n".join(lines)


def reference_page() -> str:
    """Return the page of the reference (Markdown)."""
    head = "| state | " + " | ".join(event.name for event in AcquisitionEvent) + " |"
    rule = "|---|" + "---|" * len(AcquisitionEvent)
    rows = [
        f"| {state.name} | " + " | ".join(TRANSITIONS[state][event].name for event in AcquisitionEvent) + " |"
        for state in AcquisitionState
    ]
    actions = [f"| {state.name} | {action} |" for state, action in ACTIONS.items()]
    meanings = [f"| {event.name} | {meaning} |" for event, meaning in MEANINGS.items()]
    parts = [
        "# States of an acquisition",
        "Printed by `soo acquire --states` from the table that the code runs by,\n"
        "`service/frontend/acquisition/states.py`. `tests/docs/test_how_to.py` holds page and table equal.",
        "```mermaid\n" + diagram() + "\n```",
        "\n".join(["| state | action |", "|---|---|", *actions]),
        "\n".join([head, rule, *rows]),
        "\n".join(["| event | meaning |", "|---|---|", *meanings]),
        "A stop is looked at between actions: the cycle in hand is finished and its row handed over. A thread that\n"
        "hangs beyond every bound of its action is shown as STUCK in the report of the link, and its line is cut.",
    ]
    return "\n\n".join(parts) + "\n"
