"""Life of a command: one table.

Law of this file: a change that does not stand in `LIVES` does not happen; what has gone out cannot be called back,
only its report ends it.
"""

from enum import Enum


class Life(Enum):
    """Where a command stands."""

    PREPARED = "computed and checked, waiting for another person"
    CONFIRMED = "confirmed, about to be released"
    RELEASED = "given out for uplink; its effect is uncertain until it is reported"
    SENT = "the centre reports that it was uplinked"
    EXECUTED = "reported executed: known input of the filter"
    FAILED = "reported not executed, or in part"
    EXPIRED = "not confirmed in time"
    CANCELLED = "taken back before its release"
    REJECTED = "a trip came before its release"


class Turn(Enum):
    """What moves a command."""

    CONFIRM = "another person confirms the same digest in time"
    RELEASE = "every check holds at the moment of release"
    SENT = "report: uplinked"
    EXECUTED = "report: executed"
    FAILED = "report: failed"
    EXPIRE = "its time is over, or the uplink cannot bring it before its start any more"
    CANCEL = "an operator takes it back"
    REJECT = "the interlock tripped"


LIVES: dict[Life, dict[Turn, Life]] = {
    Life.PREPARED: {
        Turn.CONFIRM: Life.CONFIRMED,
        Turn.EXPIRE: Life.EXPIRED,
        Turn.CANCEL: Life.CANCELLED,
        Turn.REJECT: Life.REJECTED,
    },
    Life.CONFIRMED: {
        Turn.RELEASE: Life.RELEASED,
        Turn.EXPIRE: Life.EXPIRED,
        Turn.CANCEL: Life.CANCELLED,
        Turn.REJECT: Life.REJECTED,
    },
    Life.RELEASED: {Turn.SENT: Life.SENT, Turn.EXECUTED: Life.EXECUTED, Turn.FAILED: Life.FAILED},
    Life.SENT: {Turn.EXECUTED: Life.EXECUTED, Turn.FAILED: Life.FAILED},
    Life.EXECUTED: {},
    Life.FAILED: {},
    Life.EXPIRED: {},
    Life.CANCELLED: {},
    Life.REJECTED: {},
}

#: waiting for a release
OPEN = frozenset({Life.PREPARED, Life.CONFIRMED})
#: gone out, nobody has told what became of it
UNREPORTED = frozenset({Life.RELEASED, Life.SENT})


def next_life(life: Life, turn: Turn) -> Life | None:
    """Return where a turn leads, None where it is illegal.

    Examples
    --------
    >>> next_life(Life.RELEASED, Turn.CANCEL) is None
    True
    """
    return LIVES[life].get(turn)
