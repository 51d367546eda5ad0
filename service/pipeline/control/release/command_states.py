"""States of a command and what moves it: one table.

Law of this file: only changes in `COMMAND_TRANSITIONS` happen; a released command is ended by its report alone.
"""

from enum import Enum

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
