"""States of an acquisition as a table, its settings, and the orders of operators."""

import threading
import time
from dataclasses import dataclass, fields
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


#: an order is noticed within this time, s
_POLL_S = 0.2


class AcquisitionOrders:
    """Orders to one acquisition.

    Parameters
    ----------
    stop : threading.Event
        End of the run; ends every wait.
    """

    def __init__(self, stop: threading.Event) -> None:
        self._stop = stop
        self._lock = threading.Lock()
        self._is_enabled = True
        self._resets_wanted = 0
        self._is_reset_here = False
        #: how many of the service's resets have been carried out
        self.resets_seen = 0
        self._has_heard = False

    def apply(self, *, is_enabled: bool, resets: int) -> None:
        """Apply the state that the service requests: link enabled or not, and number of resets so far.

        Resets asked for before the first answer were meant for an earlier start and are not carried out once more.
        """
        with self._lock:
            if not self._has_heard:
                self._has_heard, self.resets_seen = True, max(self.resets_seen, resets)
            self._is_enabled, self._resets_wanted = is_enabled, resets

    def reset(self) -> None:
        """Order a reset at this station."""
        with self._lock:
            self._is_reset_here = True

    def next(self, state: AcquisitionState) -> AcquisitionEvent | None:
        """Return the order that applies in a state; a reset counts as carried out."""
        with self._lock:
            is_reset = self._is_reset_here or self._resets_wanted > self.resets_seen
            self._is_reset_here = False
            self.resets_seen = max(self.resets_seen, self._resets_wanted)
            if self._is_enabled != (state is not AcquisitionState.DISABLED):
                return AcquisitionEvent.ENABLE if self._is_enabled else AcquisitionEvent.DISABLE
            return AcquisitionEvent.RESET if is_reset else None

    def is_pending(self, state: AcquisitionState) -> bool:
        """Return whether there is an order that applies in a state."""
        with self._lock:
            is_reset = self._is_reset_here or self._resets_wanted > self.resets_seen
            return is_reset or self._is_enabled != (state is not AcquisitionState.DISABLED)

    def wait(self, wait_s: float, state: AcquisitionState) -> None:
        """Wait, but no longer than until an order or the stop comes."""
        end_s = time.monotonic() + wait_s
        while not self._stop.is_set() and not self.is_pending(state):
            remaining_s = end_s - time.monotonic()
            if remaining_s <= 0.0:
                return
            self._stop.wait(min(remaining_s, _POLL_S))


#: periods without a good row after which the session is opened again
WATCHDOG_PERIODS = 3.0


@dataclass(frozen=True, slots=True)
class AcquisitionSettings:
    """Pace and patience."""

    resource: str
    #: time from row to row, s; 0 = as fast as the analyzer answers
    period_s: float
    #: take epochs from the analyzer's clock
    use_analyzer_clock: bool = False
    #: bound on connecting and on every answer, of a sweep beyond one and a half sweep times, s
    io_timeout_s: float = 5.0
    #: further wait for a sweep that a trigger, or a simulator in step with others, holds back, s
    hold_s: float = 0.0


@dataclass(slots=True)
class AcquisitionCounters:
    """Counters of one acquisition since its start."""

    rows: int = 0
    #: rows that were only in memory when they were handed over
    unwritten: int = 0
    #: rows in which at least one carrier was looked for in a fresh trace of numbers
    good_rows: int = 0
    faults: int = 0
    sessions: int = 0
    #: cycles that began later than their period allows
    overruns: int = 0
    #: settings found changed by somebody else, and restored
    foreign_changes: int = 0
    #: sessions opened again because no good row had come for three periods
    watchdog: int = 0
    #: jumps of the clock that stamps the rows
    clock_jumps: int = 0
    #: resets that an operator asked for
    resets: int = 0
    #: actions that hung beyond every bound
    stuck: int = 0
    state: AcquisitionState = AcquisitionState.CONNECT
    last_fault: str = ""
    #: epoch of the newest good row, microseconds UTC
    last_good_us: int | None = None

    def as_json(self) -> dict[str, int]:
        """Return the numbers by name."""
        return {
            each.name: getattr(self, each.name)
            for each in fields(self)
            if each.name not in {"state", "last_fault", "last_good_us"}
        }
