"""The states of an acquisition and what moves it from one to another: a table, and the page drawn from it.

Law of this file: a change of state that does not stand in `TRANSITIONS` does not happen.
"""

from enum import Enum, auto


class State(Enum):
    """Where the acquisition stands."""

    CONNECT = auto()
    IDENTIFY = auto()
    CONFIGURE = auto()
    MEASURE = auto()
    BACKOFF = auto()
    DISABLED = auto()


class Event(Enum):
    """How the action of a state ended, or what an operator ordered before it."""

    OK = auto()
    FAULT = auto()
    RESET = auto()
    DISABLE = auto()
    ENABLE = auto()


#: what is done in each state
ACTIONS: dict[State, str] = {
    State.CONNECT: "open a session",
    State.IDENTIFY: "ask `*IDN?`, choose the driver, reset the analyzer, set detector, unit and format",
    State.CONFIGURE: "send the settings of the first sweep and read them back",
    State.MEASURE: "wait for the period, take one cycle of sweeps, hand its row over",
    State.BACKOFF: "close the session; wait 1, 2, 4 .. 60 s, shortened by up to a fifth at random",
    State.DISABLED: "rest with the session closed until an operator enables the link again",
}
#: what each event means
MEANINGS: dict[Event, str] = {
    Event.OK: "the action succeeded",
    Event.FAULT: "no answer, a broken line, an answer that makes no sense, a refusal, or no good row for three periods",
    Event.RESET: "an operator asked for a new session; waiting times begin anew",
    Event.DISABLE: "an operator disabled the link",
    Event.ENABLE: "an operator enabled the link",
}


def _row(state: State, on_success: State, on_fault: State = State.BACKOFF) -> dict[Event, State]:
    """Return the row of a state that works; orders mean the same in all of them."""
    return {
        Event.OK: on_success,
        Event.FAULT: on_fault,
        Event.RESET: State.CONNECT,
        Event.DISABLE: State.DISABLED,
        Event.ENABLE: state,
    }


TRANSITIONS: dict[State, dict[Event, State]] = {
    State.CONNECT: _row(State.CONNECT, State.IDENTIFY),
    State.IDENTIFY: _row(State.IDENTIFY, State.CONFIGURE),
    State.CONFIGURE: _row(State.CONFIGURE, State.MEASURE),
    State.MEASURE: _row(State.MEASURE, State.MEASURE),
    State.BACKOFF: _row(State.BACKOFF, State.CONNECT, State.CONNECT),
    State.DISABLED: {
        Event.OK: State.DISABLED,
        Event.FAULT: State.DISABLED,
        Event.RESET: State.DISABLED,
        Event.DISABLE: State.DISABLED,
        Event.ENABLE: State.CONNECT,
    },
}


def diagram() -> str:
    """Return the table as a Mermaid state diagram; what stays in its state is left out, but for measuring."""
    lines = ["stateDiagram-v2", "    [*] --> CONNECT"]
    for state, row in TRANSITIONS.items():
        targets: dict[State, list[str]] = {}
        for event, target in row.items():
            if target is not state or (state is State.MEASURE and event is Event.OK):
                targets.setdefault(target, []).append(event.name)
        lines += [f"    {state.name} --> {target.name}: {', '.join(events)}" for target, events in targets.items()]
    return "\n".join(lines)


def reference_page() -> str:
    """Return the page of the reference (Markdown)."""
    head = "| state | " + " | ".join(event.name for event in Event) + " |"
    rule = "|---|" + "---|" * len(Event)
    rows = [
        f"| {state.name} | " + " | ".join(TRANSITIONS[state][event].name for event in Event) + " |" for state in State
    ]
    actions = [f"| {state.name} | {action} |" for state, action in ACTIONS.items()]
    meanings = [f"| {event.name} | {meaning} |" for event, meaning in MEANINGS.items()]
    parts = [
        "# States of an acquisition",
        "Printed by `soo acquire --states` from the table that the code runs by,\n"
        "`service/frontend/acquisition/states.py`. `tests/docs/test_watch_the_links.py` holds page and table equal.",
        "```mermaid\n" + diagram() + "\n```",
        "\n".join(["| state | action |", "|---|---|", *actions]),
        "\n".join([head, rule, *rows]),
        "\n".join(["| event | meaning |", "|---|---|", *meanings]),
        "A stop is looked at between actions: the cycle in hand is finished and its row handed over. A thread that\n"
        "hangs beyond every bound of its action is shown as STUCK in the report of the link, and its line is cut.",
    ]
    return "\n\n".join(parts) + "\n"
