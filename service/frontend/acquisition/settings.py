"""Pace and patience of an acquisition, and what it counts."""

from dataclasses import dataclass, fields

from service.frontend.acquisition.states import AcquisitionState

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
