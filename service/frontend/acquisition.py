"""The acquisition of one analyzer: a state machine as a table, run by one thread.

Law of this file: everything that moves the acquisition from state to state stands in `TRANSITIONS`. Each state has one
action; an action either succeeds, or meets a fault of the analyzer. Whatever the fault, the session is closed and a new
one opened after a wait - never is a query sent into a session that owes an answer.

::

    state      action                                  OK         FAULT
    CONNECT    open the session                        IDENTIFY   BACKOFF
    IDENTIFY   *IDN?, choose the driver, preset        CONFIGURE  BACKOFF
    CONFIGURE  settings of the first sweep, read back  MEASURE    BACKOFF
    MEASURE    one cycle of sweeps -> one row          MEASURE    BACKOFF
    BACKOFF    close, wait 1, 2, 4 .. 60 s             CONNECT    CONNECT

A stop is looked at between actions: the cycle in hand is finished and its row handed over.
"""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto

from service.client.backoff import Backoff
from service.frontend.drivers.base import SweepRefusedError
from service.frontend.drivers.choice import dialect_of, identify
from service.frontend.drivers.scpi_driver import ScpiDriver
from service.frontend.evaluation import MeasuredRow, TaskEvaluation
from service.frontend.measurement_task import MeasurementTask, SweepPart
from service.frontend.visa_session import AnalyzerIOError, VisaSession
from service.records.quality_flag import QualityFlag
from service.records.sweep import Sweep

logger = logging.getLogger("service.frontend.acquisition")

#: what an analyzer can do to a cycle; a ValueError is an answer that does not mean what it should
FAULTS = (AnalyzerIOError, SweepRefusedError, ValueError)


class State(Enum):
    """Where the acquisition stands."""

    CONNECT = auto()
    IDENTIFY = auto()
    CONFIGURE = auto()
    MEASURE = auto()
    BACKOFF = auto()


class Event(Enum):
    """How the action of a state ended."""

    OK = auto()
    FAULT = auto()


TRANSITIONS: dict[State, dict[Event, State]] = {
    State.CONNECT: {Event.OK: State.IDENTIFY, Event.FAULT: State.BACKOFF},
    State.IDENTIFY: {Event.OK: State.CONFIGURE, Event.FAULT: State.BACKOFF},
    State.CONFIGURE: {Event.OK: State.MEASURE, Event.FAULT: State.BACKOFF},
    State.MEASURE: {Event.OK: State.MEASURE, Event.FAULT: State.BACKOFF},
    State.BACKOFF: {Event.OK: State.CONNECT, Event.FAULT: State.CONNECT},
}


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
    #: settings are read back after a sweep when they have not been for this long, s
    readback_s: float = 0.5


@dataclass(slots=True)
class AcquisitionCounters:
    """What happened so far."""

    rows: int = 0
    faults: int = 0
    sessions: int = 0
    #: cycles that began later than their period allows
    overruns: int = 0
    state: State = State.CONNECT
    last_fault: str = ""


class Acquisition:
    """Measure one task on one analyzer and hand the rows on.

    Parameters
    ----------
    task : MeasurementTask
        Checked by the planner.
    settings : AcquisitionSettings
        Pace and patience.
    hand_over : callable
        Takes each row; returns False when it cannot, which only a stop may cause. It may block: that holds the
        sweeping back.
    now_us : callable
        Present, microseconds UTC.
    stop : threading.Event
        Ends the run after the cycle in hand.
    backoff : Backoff
        Waiting times after faults.
    keep_trace : callable
        Takes every sweep as evidence; what it does not keep is gone.
    """

    def __init__(
        self,
        task: MeasurementTask,
        settings: AcquisitionSettings,
        hand_over: Callable[[MeasuredRow], bool],
        now_us: Callable[[], int],
        stop: threading.Event,
        backoff: Backoff | None = None,
        keep_trace: Callable[[Sweep], None] = lambda _: None,
    ) -> None:
        self.counters = AcquisitionCounters()
        self._task = task
        self._settings = settings
        self._hand_over = hand_over
        self._keep_trace = keep_trace
        self._now_us = now_us
        self._stop = stop
        self._backoff = backoff or Backoff()
        self._evaluation = TaskEvaluation(task)
        self._sweeps = tuple(sweep for sweep in task.sweeps if task.carriers_of(sweep.id))
        self._session: VisaSession | None = None
        self._driver: ScpiDriver | None = None
        self._configured = _Configured()
        self._had_fault = False
        self._due_s: float | None = None
        self._actions: dict[State, Callable[[], None]] = {
            State.CONNECT: self._connect,
            State.IDENTIFY: self._identify,
            State.CONFIGURE: self._configure,
            State.MEASURE: self._measure,
            State.BACKOFF: self._wait,
        }

    def run(self) -> None:
        """Run until the stop; returns with the session closed."""
        try:
            while not self._stop.is_set():
                self.step()
        finally:
            self._close()

    def step(self) -> State:
        """Carry out the action of the state and return the next one."""
        state = self.counters.state
        try:
            self._actions[state]()
            event = Event.OK
        except FAULTS as fault:
            self._note(state, fault)
            event = Event.FAULT
        self.counters.state = TRANSITIONS[state][event]
        return self.counters.state

    def _connect(self) -> None:
        self.counters.sessions += 1
        self._session = VisaSession(self._settings.resource, self._settings.io_timeout_s, self._stop.is_set)

    def _identify(self) -> None:
        if self._session is None:
            raise AnalyzerIOError("no session")
        identity = identify(self._session)
        dialect = dialect_of(identity, self._task.task.analyzer.dialect)
        self._driver = ScpiDriver(
            self._session,
            identity,
            dialect,
            self._now_us,
            use_analyzer_clock=self._settings.use_analyzer_clock,
            io_timeout_s=self._settings.io_timeout_s,
            hold_s=self._settings.hold_s,
            enbw_ratio=self._task.task.analyzer.enbw_ratio,
            readback_s=self._settings.readback_s,
        )
        self._driver.preset()
        self._configured = _Configured()
        logger.info("analyzer %s %s speaks %s", identity.vendor, identity.model, dialect.name)

    def _configure(self) -> None:
        """Configure the first sweep, so that a task the analyzer cannot take shows before any row."""
        self._prepare(self._sweeps[0])

    def _measure(self) -> None:
        """Take one cycle and hand its row over."""
        self._pace()
        if self._stop.is_set():
            return
        sweeps = self._cycle()
        for sweep in sweeps.values():
            if sweep is not None:
                self._keep_trace(sweep)
        driver = self._ready()
        extra = QualityFlag.SIMULATED if driver.features.has_dwell_epoch else QualityFlag(0)
        if self._had_fault and self.counters.rows:
            extra |= QualityFlag.RECONNECTED
        row = self._evaluation.row(sweeps, extra=int(extra))
        if self._hand_over(row):
            self.counters.rows += 1
        self._had_fault = False
        self._backoff.reset()

    def _cycle(self) -> dict[str, Sweep | None]:
        """Take all sweeps; a refused one is left out while another one succeeds."""
        sweeps: dict[str, Sweep | None] = {}
        refusal: SweepRefusedError | None = None
        for sweep in self._sweeps:
            try:
                self._prepare(sweep)
                sweeps[sweep.id] = self._ready().take(sweep)
            except SweepRefusedError as error:
                logger.warning("%s", error)
                self._configured = _Configured()
                sweeps[sweep.id], refusal = None, error
        if refusal is not None and not any(sweeps.values()):
            raise refusal
        self._report_remarks()
        return sweeps

    def _prepare(self, sweep: SweepPart) -> None:
        """Send and read back the settings of a sweep unless they stand and were read lately."""
        now_s = time.monotonic()
        is_fresh = now_s - self._configured.at_s < self._settings.readback_s
        if self._configured.sweep_id == sweep.id and is_fresh:
            return
        self._ready().configure(sweep, self._task.input)
        self._configured = _Configured(sweep.id, now_s)

    def _pace(self) -> None:
        """Wait until the next row is due."""
        now_s = time.monotonic()
        if self._settings.period_s <= 0.0:
            return
        if self._due_s is None:
            self._due_s = now_s
        if now_s > self._due_s + self._settings.period_s:
            self.counters.overruns += 1
            self._due_s = now_s
        if self._due_s > now_s:
            self._stop.wait(self._due_s - now_s)
        self._due_s += self._settings.period_s

    def _wait(self) -> None:
        """Close what is left of the session and wait."""
        self._close()
        wait_s = self._backoff.next_s()
        logger.info("next attempt in %.1f s", wait_s)
        self._stop.wait(wait_s)

    def _ready(self) -> ScpiDriver:
        """Return the driver of the open session."""
        if self._driver is None:
            raise AnalyzerIOError("no session")
        return self._driver

    def _note(self, state: State, fault: Exception) -> None:
        """Count and log a fault."""
        self._had_fault = True
        self.counters.faults += 1
        self.counters.last_fault = str(fault)
        logger.warning("fault while in %s: %s", state.name, fault)

    def _report_remarks(self) -> None:
        """Log what the analyzer said without refusing."""
        driver = self._ready()
        for remark in driver.remarks:
            logger.warning("analyzer says %d %s", remark.code, remark.text)
        driver.remarks.clear()

    def _close(self) -> None:
        """Close the session, whoever holds it."""
        if self._session is not None:
            self._session.close()
        self._session = self._driver = None


@dataclass(frozen=True, slots=True)
class _Configured:
    """Which sweep the analyzer is set to, and when that was read back last (monotonic seconds)."""

    sweep_id: str = ""
    at_s: float = field(default=float("-inf"))
