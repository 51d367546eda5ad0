"""Progress of a sweep: its states and its pace. No trace, no world, no SCPI.

::

    state       what happens                       next state   OPERation:CONDition
    IDLE        a single sweep is asked for        WAITING      bit 5, waiting for trigger
    WAITING     the row is allowed, pace virtual   IDLE         0; the sweep is complete at once
    WAITING     the row is allowed, pace real      SWEEPING     bit 3, sweeping
    SWEEPING    its time is over                   IDLE         0
    SWEEPING    a setting that shapes it changes   SWEEPING     bit 3; it begins again
    WAITING or SWEEPING    ABORt, *RST             IDLE         0
    IDLE        INIT:CONT ON, pace real            CONTINUOUS   bit 3; one sweep after the other
    CONTINUOUS  a setting changes, ABORt           CONTINUOUS   bit 3; the first one begins again
    CONTINUOUS  INIT:CONT OFF                      IDLE         0
"""

import time
from collections.abc import Callable
from enum import Enum, auto

from analyzer_sim.scpi.status import OPERATION_SWEEPING, OPERATION_WAITING_FOR_TRIGGER


class Pace(Enum):
    """Pace of sweeps."""

    #: no time at all
    VIRTUAL = "virtual"
    #: its sweep time, by the wall clock
    REAL = "real"


class SweepState(Enum):
    """State of the sweep; the module docstring has the transitions."""

    IDLE = auto()
    WAITING = auto()
    SWEEPING = auto()
    CONTINUOUS = auto()


#: bits of OPERation:CONDition in each state
OPERATION_BITS: dict[SweepState, int] = {
    SweepState.IDLE: 0,
    SweepState.WAITING: OPERATION_WAITING_FOR_TRIGGER,
    SweepState.SWEEPING: OPERATION_SWEEPING,
    SweepState.CONTINUOUS: OPERATION_SWEEPING,
}


class SweepProgress:
    """The life of sweeps of one instrument.

    Parameters
    ----------
    pace : Pace
        How long a sweep lasts.
    clock : callable
        Seconds that never go back.
    """

    def __init__(self, pace: Pace = Pace.VIRTUAL, clock: Callable[[], float] = time.monotonic) -> None:
        self.pace = pace
        self._clock = clock
        self._state = SweepState.IDLE
        self._began_s = 0.0
        self._duration_s = 0.0
        #: changes of state so far, for those who wait for one
        self.changes = 0

    @property
    def state(self) -> SweepState:
        """Where the sweep stands."""
        return self._state

    @property
    def is_pending(self) -> bool:
        """Return whether a single sweep has been asked for and is not complete."""
        return self._state in {SweepState.WAITING, SweepState.SWEEPING}

    @property
    def is_running(self) -> bool:
        """Return whether time passes for a sweep."""
        return self._state in {SweepState.SWEEPING, SweepState.CONTINUOUS}

    @property
    def sweeps_done(self) -> int:
        """Sweeps completed since the present run of sweeps began."""
        return int((self._clock() - self._began_s) / self._duration_s)

    @property
    def remaining_s(self) -> float | None:
        """Time until the first sweep is complete; ``None`` when no time is waited for."""
        if not self.is_running or self.sweeps_done:
            return None
        return max(0.0, self._began_s + self._duration_s - self._clock())

    @property
    def is_due(self) -> bool:
        """Return whether the sweep that runs has had its time."""
        return self._state is SweepState.SWEEPING and self.sweeps_done > 0

    def wait(self) -> None:
        """Ask for a single sweep."""
        self._move(SweepState.WAITING)

    def start(self, duration_s: float) -> None:
        """Begin the sweep that waits, or begin the one that runs again."""
        self._time(duration_s)
        self._move(SweepState.SWEEPING)

    def repeat(self, duration_s: float) -> None:
        """Begin to sweep without end, or begin that again."""
        self._time(duration_s)
        self._move(SweepState.CONTINUOUS)

    def restart(self, duration_s: float) -> None:
        """Begin the sweep that runs again."""
        self._time(duration_s)
        self.changes += 1

    def end(self) -> None:
        """Let nothing run any more."""
        self._move(SweepState.IDLE)

    def _time(self, duration_s: float) -> None:
        self._began_s, self._duration_s = self._clock(), duration_s

    def _move(self, state: SweepState) -> None:
        self._state = state
        self.changes += 1
