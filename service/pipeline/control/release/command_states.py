"""States of a command and of the interlock, as tables."""

from enum import Enum
from functools import cache
from typing import NamedTuple

from service.records.operations.release import CommandState

MEANINGS = {
    CommandState.PREPARED: "computed and checked, waiting for another person",
    CommandState.CONFIRMED: "confirmed, about to be released",
    CommandState.RELEASED: "given out for uplink; its effect is uncertain until it is reported",
    CommandState.SENT: "the centre reports that it was uplinked",
    CommandState.EXECUTED: "reported executed: known input of the filter",
    CommandState.FAILED: "reported not executed, or in part",
    CommandState.EXPIRED: "not confirmed in time",
    CommandState.CANCELLED: "taken back before its release",
    CommandState.REJECTED: "a trip came before its release",
}


class CommandTransition(Enum):
    """Transition of a command."""

    CONFIRM = "another person confirms the same digest in time"
    RELEASE = "every check holds at the moment of release"
    SENT = "report: uplinked"
    EXECUTED = "report: executed"
    FAILED = "report: failed"
    EXPIRE = "its time is over, or the uplink cannot bring it before its start any more"
    CANCEL = "an operator takes it back"
    REJECT = "the interlock tripped"


_UNRELEASED = {
    CommandTransition.EXPIRE: CommandState.EXPIRED,
    CommandTransition.CANCEL: CommandState.CANCELLED,
    CommandTransition.REJECT: CommandState.REJECTED,
}
_REPORTED = {CommandTransition.EXECUTED: CommandState.EXECUTED, CommandTransition.FAILED: CommandState.FAILED}
#: the other states are ends
COMMAND_TRANSITIONS: dict[CommandState, dict[CommandTransition, CommandState]] = {
    state: {} for state in CommandState
} | {
    CommandState.PREPARED: {CommandTransition.CONFIRM: CommandState.CONFIRMED, **_UNRELEASED},
    CommandState.CONFIRMED: {CommandTransition.RELEASE: CommandState.RELEASED, **_UNRELEASED},
    CommandState.RELEASED: {CommandTransition.SENT: CommandState.SENT, **_REPORTED},
    CommandState.SENT: _REPORTED,
}

#: transitions that the centre reports
REPORTS = frozenset({CommandTransition.SENT, CommandTransition.EXECUTED, CommandTransition.FAILED})
#: waiting for a release
OPEN = frozenset({CommandState.PREPARED, CommandState.CONFIRMED})
#: released, not reported
UNREPORTED = frozenset({CommandState.RELEASED, CommandState.SENT})


def next_state(state: CommandState, transition: CommandTransition) -> CommandState | None:
    """Return where a transition leads, None where it is illegal.

    Examples
    --------
    >>> next_state(CommandState.RELEASED, CommandTransition.CANCEL) is None
    True
    """
    return COMMAND_TRANSITIONS[state].get(transition)


class State(Enum):
    """State of the interlock."""

    #: a reason stands, control is not armed, or the good minutes are not over
    INHIBITED = "no torque may go"
    ARMED = "each command needs to be prepared and confirmed"
    ENGAGED = "commands within the authorised envelope go by themselves, until the authorisation ends"
    RECOVERY = "roll or pitch beyond 0.4 deg: single commands, each confirmed by an approver"
    #: the reason that inhibits doubts the angles of the present alone
    BALANCE = "no angle is corrected; commands that balance the known torque may go, released as before"
    TRIPPED = "no torque may go until a person resets"

    # that of Enum is a function of Python, and every row asks some hundred times
    __hash__ = object.__hash__


#: states in which a command that corrects angles may go
MAY_RELEASE = frozenset({State.ARMED, State.ENGAGED, State.RECOVERY})


class Trigger(Enum):
    """Trigger of a transition of the interlock."""

    TRIP = "a condition that trips"
    INHIBIT = "a condition that inhibits"
    CLEAR = "no such condition for 10 min"
    BEYOND = "roll or pitch passes 0.4 deg"
    WITHIN = "both are back"
    LAPSE = "the known torque may not be balanced any more"
    EXPIRE = "the authorisation has ended"
    ARM = "an operator arms control"
    ENGAGE = "a person asks for standing authorisation, or joins who asked"
    DISENGAGE = "an operator takes authorisation or arming back"
    RESET = "a person resets the trip"

    __hash__ = object.__hash__


class Guard(Enum):
    """Guard of a transition."""

    ALWAYS = ""
    BEYOND_AND_ARMED = "armed, beyond 0.4 deg"
    AUTHORISED = "the authorisation still holds"
    ARMED = "control was armed"
    AFTER_RESET = "a trip was reset: torques are no longer withheld"
    MAY_BALANCE = "the known torque may be balanced"
    MAY_ARM_BEYOND = "10 good minutes, beyond 0.4 deg"
    MAY_ARM = "10 good minutes"
    SECOND_PERSON = "another person asked for the same within 10 min"
    FIRST_PERSON = "nobody has asked yet"
    NO_TRIP_STANDS = "no condition that trips stands any more"


#: code with which a trigger is refused where no guard of its rows holds
REFUSALS: dict[Trigger, str] = {
    Trigger.ARM: "interlock.inhibited",
    Trigger.ENGAGE: "interlock.second_person",
    Trigger.DISENGAGE: "interlock.not_armed",
    Trigger.RESET: "interlock.trip_stands",
}


class Transition(NamedTuple):
    """One row of the table."""

    source: State
    trigger: Trigger
    guard: Guard
    target: State


TRANSITIONS: tuple[Transition, ...] = (
    Transition(State.INHIBITED, Trigger.TRIP, Guard.ALWAYS, State.TRIPPED),
    Transition(State.INHIBITED, Trigger.CLEAR, Guard.BEYOND_AND_ARMED, State.RECOVERY),
    Transition(State.INHIBITED, Trigger.CLEAR, Guard.AUTHORISED, State.ENGAGED),
    Transition(State.INHIBITED, Trigger.CLEAR, Guard.ARMED, State.ARMED),
    Transition(State.INHIBITED, Trigger.CLEAR, Guard.AFTER_RESET, State.INHIBITED),
    Transition(State.INHIBITED, Trigger.ARM, Guard.MAY_ARM_BEYOND, State.RECOVERY),
    Transition(State.INHIBITED, Trigger.ARM, Guard.MAY_ARM, State.ARMED),
    Transition(State.INHIBITED, Trigger.BEYOND, Guard.AUTHORISED, State.INHIBITED),
    Transition(State.INHIBITED, Trigger.EXPIRE, Guard.ALWAYS, State.INHIBITED),
    Transition(State.INHIBITED, Trigger.DISENGAGE, Guard.ARMED, State.INHIBITED),
    Transition(State.ARMED, Trigger.TRIP, Guard.ALWAYS, State.TRIPPED),
    Transition(State.ARMED, Trigger.INHIBIT, Guard.MAY_BALANCE, State.BALANCE),
    Transition(State.ARMED, Trigger.INHIBIT, Guard.ALWAYS, State.INHIBITED),
    Transition(State.ARMED, Trigger.BEYOND, Guard.ALWAYS, State.RECOVERY),
    Transition(State.ARMED, Trigger.ENGAGE, Guard.SECOND_PERSON, State.ENGAGED),
    Transition(State.ARMED, Trigger.ENGAGE, Guard.FIRST_PERSON, State.ARMED),
    Transition(State.ARMED, Trigger.DISENGAGE, Guard.ALWAYS, State.INHIBITED),
    Transition(State.ENGAGED, Trigger.TRIP, Guard.ALWAYS, State.TRIPPED),
    Transition(State.ENGAGED, Trigger.INHIBIT, Guard.MAY_BALANCE, State.BALANCE),
    Transition(State.ENGAGED, Trigger.INHIBIT, Guard.ALWAYS, State.INHIBITED),
    Transition(State.ENGAGED, Trigger.BEYOND, Guard.ALWAYS, State.RECOVERY),
    Transition(State.ENGAGED, Trigger.EXPIRE, Guard.ALWAYS, State.ARMED),
    Transition(State.ENGAGED, Trigger.DISENGAGE, Guard.ALWAYS, State.ARMED),
    Transition(State.RECOVERY, Trigger.TRIP, Guard.ALWAYS, State.TRIPPED),
    Transition(State.RECOVERY, Trigger.INHIBIT, Guard.MAY_BALANCE, State.BALANCE),
    Transition(State.RECOVERY, Trigger.INHIBIT, Guard.ALWAYS, State.INHIBITED),
    Transition(State.RECOVERY, Trigger.WITHIN, Guard.ALWAYS, State.ARMED),
    Transition(State.RECOVERY, Trigger.DISENGAGE, Guard.ALWAYS, State.INHIBITED),
    Transition(State.BALANCE, Trigger.TRIP, Guard.ALWAYS, State.TRIPPED),
    Transition(State.BALANCE, Trigger.EXPIRE, Guard.ALWAYS, State.BALANCE),
    Transition(State.BALANCE, Trigger.LAPSE, Guard.ALWAYS, State.INHIBITED),
    Transition(State.BALANCE, Trigger.CLEAR, Guard.BEYOND_AND_ARMED, State.RECOVERY),
    Transition(State.BALANCE, Trigger.CLEAR, Guard.AUTHORISED, State.ENGAGED),
    Transition(State.BALANCE, Trigger.CLEAR, Guard.ARMED, State.ARMED),
    Transition(State.BALANCE, Trigger.DISENGAGE, Guard.ALWAYS, State.INHIBITED),
    Transition(State.TRIPPED, Trigger.RESET, Guard.NO_TRIP_STANDS, State.INHIBITED),
)


@cache
def rows_of(state: State, trigger: Trigger) -> tuple[Transition, ...]:
    """Return the rows of a state and a trigger, in order; none: the trigger means nothing there.

    Examples
    --------
    >>> [row.target.name for row in rows_of(State.ENGAGED, Trigger.BEYOND)]
    ['RECOVERY']
    """
    return tuple(row for row in TRANSITIONS if row.source is state and row.trigger is trigger)
