"""A measuring station: analyzers, each with an acquisition, a spool and an uploader of its own, and their common end.

Law of this file: a lane starts two threads and ends them in order - first the acquisition after the sweep in hand, then
the uploader after what waits. A thread that dies takes the station down with its error; nothing runs on in half. Lanes
share nothing that one of them could hold up: no session, no connection, no queue.
"""

import logging
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from service.client.backoff import Backoff
from service.client.service_client import ServiceClient
from service.frontend.acquisition import states
from service.frontend.acquisition.evaluation import MeasuredRow, MeasuringCycle, TaskEvaluation, is_good
from service.frontend.acquisition.states import AcquisitionCounters, AcquisitionSettings
from service.frontend.drivers.dialects import SweepRefusedError, dialect_of, identify
from service.frontend.drivers.scpi_driver import RESET_S, ScpiDriver
from service.frontend.drivers.visa_session import AnalyzerIOError, VisaSession
from service.frontend.measurement_task import MeasurementTask
from service.frontend.spool.spool import Spool
from service.frontend.tasks.task_plan import cycle_s
from service.frontend.upload.uploader import UploadCounters, Uploader, UploadSettings
from service.records.epoch import US_PER_S
from service.records.levels.measurement import QualityFlag, Sweep

#: difference between two clocks from row to row that counts as a jump: slewing and drift stay far below, s
JUMP_S = 0.5
#: slewing changes a clock by half a thousandth at most
SLEW_RATE = 1e-3
#: rows are flagged for so long after a jump, s
SETTLE_S = 60.0


class EpochGuard:
    """Watches the clock of one acquisition.

    Parameters
    ----------
    has_monotonic : bool
        The epochs come from this computer, so that its monotonic clock can judge them.
    """

    def __init__(self, *, has_monotonic: bool) -> None:
        self.jumps = 0
        #: the newest jump in words, empty while the clock is trusted
        self.warning = ""
        self._has_monotonic = has_monotonic
        self._last: tuple[int, float] | None = None
        self._untrusted_until_s = float("-inf")

    def judge(self, epoch_us: int, monotonic_s: float) -> QualityFlag:
        """Return the flag of a row with this epoch, seen at this monotonic time."""
        jump_s = self._jump_s(epoch_us, monotonic_s)
        if jump_s is not None:
            self.jumps += 1
            self._untrusted_until_s = monotonic_s + SETTLE_S
            self.warning = f"the clock went {'back' if jump_s < 0.0 else 'forward'} by {abs(jump_s):.3f} s"
            _TASK_LOG.warning("%s; rows are flagged CLOCK_UNSYNC for %g s", self.warning, SETTLE_S)
        self._last = (epoch_us, monotonic_s)
        if monotonic_s < self._untrusted_until_s:
            return QualityFlag.CLOCK_UNSYNC
        self.warning = ""
        return QualityFlag(0)

    def _jump_s(self, epoch_us: int, monotonic_s: float) -> float | None:
        """Return by how much the clock jumped since the last row; None when it did not."""
        if self._last is None:
            return None
        passed_s = (epoch_us - self._last[0]) / US_PER_S
        if not self._has_monotonic:
            return passed_s if passed_s <= 0.0 else None
        due_s = monotonic_s - self._last[1]
        jump_s = passed_s - due_s
        return jump_s if abs(jump_s) > JUMP_S + SLEW_RATE * due_s else None


_TASK_LOG = logging.getLogger("service.frontend.station")

#: what an analyzer can do to a cycle; a ValueError is an answer that does not mean what it should
FAULTS = (AnalyzerIOError, SweepRefusedError, ValueError)


class WatchdogError(AnalyzerIOError):
    """The analyzer answers, but no good row came for three periods."""


class Acquisition:
    """Measure one task on one analyzer and hand the rows on.

    Parameters
    ----------
    task : MeasurementTask
        Checked by the planner.
    settings : AcquisitionSettings
        Pace and patience.
    hand_over : callable
        Takes each row; returns whether it is on a disk already. It may block: that holds the sweeping back.
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
        settings: states.AcquisitionSettings,
        hand_over: Callable[[MeasuredRow], bool],
        now_us: Callable[[], int],
        stop: threading.Event,
        backoff: Backoff | None = None,
        keep_trace: Callable[[Sweep], None] = lambda _: None,
    ) -> None:
        self.counters = states.AcquisitionCounters()
        self.orders = states.AcquisitionOrders(stop)
        #: what ``*IDN?`` answered and the dialect spoken, for reports
        self.identity = ""
        self._task = task
        self._settings = settings
        self._hand_over = hand_over
        self._keep_trace = keep_trace
        self._now_us = now_us
        self._stop = stop
        self._backoff = backoff or Backoff()
        self._evaluation = TaskEvaluation(task)
        self._epochs = EpochGuard(has_monotonic=not settings.use_analyzer_clock)
        self._cycle_s = cycle_s(task)
        self._watchdog_s = states.WATCHDOG_PERIODS * max(settings.period_s, self._cycle_s) + settings.hold_s
        self._session: VisaSession | None = None
        self._driver: ScpiDriver | None = None
        self._cycle: MeasuringCycle | None = None
        self._foreign_before = 0
        self._had_fault = False
        self._due_s: float | None = None
        self._last_good_s = 0.0
        self._bound_s = float("inf")
        self._actions: dict[states.AcquisitionState, Callable[[], None]] = {
            states.AcquisitionState.CONNECT: self._connect,
            states.AcquisitionState.IDENTIFY: self._identify,
            states.AcquisitionState.CONFIGURE: self._configure,
            states.AcquisitionState.MEASURE: self._measure,
            states.AcquisitionState.BACKOFF: self._wait,
            states.AcquisitionState.DISABLED: self._rest,
        }

    @property
    def period_s(self) -> float:
        """Time from row to row, s."""
        return self._settings.period_s

    @property
    def warnings(self) -> list[dict[str, str]]:
        """Return the present warnings of this analyzer."""
        cycle = self._cycle
        found = dict(cycle.findings) if cycle is not None else {}
        if self._epochs.warning:
            found["clock.jumped"] = self._epochs.warning
        if self._had_fault:
            found["analyzer.fault"] = self.counters.last_fault
        if self.is_stuck:
            found["analyzer.stuck"] = f"{self.counters.state.name} does not return within every bound of its action"
        return [{"code": code, "detail": detail[:1000]} for code, detail in found.items()]

    @property
    def is_stuck(self) -> bool:
        """Return whether the action in hand has taken longer than anything in it may."""
        return time.monotonic() > self._bound_s

    def poll(self) -> None:
        """Notice, from another thread, an action that hangs, and cut its line; a returning thread opens a new one."""
        if self.is_stuck:
            self.counters.stuck += 1
            _TASK_LOG.error(
                "analyzer %s does not return from %s; its connection is closed and opened again",
                self._settings.resource,
                self.counters.state.name,
            )
            self._allow(self._longest_s())
            if self._session is not None:
                self._session.abandon()

    def run(self) -> None:
        """Run until the stop; returns with the session closed."""
        try:
            while not self._stop.is_set():
                self.step()
        finally:
            self._bound_s = float("inf")
            self._close()

    def step(self) -> states.AcquisitionState:
        """Carry out an order or the action of the state, and return the next state."""
        state = self.counters.state
        event = self.orders.next(state)
        if event is not None:
            self._follow(event)
        else:
            event = self._act(state)
        self.counters.state = states.TRANSITIONS[state][event]
        return self.counters.state

    def _act(self, state: states.AcquisitionState) -> states.AcquisitionEvent:
        """Carry out the action of a state."""
        self._allow(self._longest_s())
        try:
            self._actions[state]()
        except FAULTS as fault:
            self._note(state, fault)
            return states.AcquisitionEvent.FAULT
        return states.AcquisitionEvent.OK

    def _follow(self, event: states.AcquisitionEvent) -> None:
        """Carry out an order: whatever it is, the session is closed and waiting times begin again."""
        _TASK_LOG.info("analyzer %s: an operator ordered %s", self._settings.resource, event.name)
        if event is states.AcquisitionEvent.RESET:
            self.counters.resets += 1
            self._had_fault = True
        self._backoff.reset()
        self._close()

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
        )
        self._driver.preset()
        self._cycle = MeasuringCycle(self._task, self._evaluation, self._driver, self._keep_trace)
        self._foreign_before = self.counters.foreign_changes
        self.identity = f"{identity.vendor} {identity.model} {identity.serial} {identity.firmware} ({dialect.name})"
        _TASK_LOG.info("analyzer %s %s speaks %s", identity.vendor, identity.model, dialect.name)

    def _configure(self) -> None:
        """Configure the first sweep; the watchdog begins to count."""
        self._measuring().configure()
        self._last_good_s = time.monotonic()

    def _measure(self) -> None:
        """Take one cycle and hand its row over."""
        self._pace()
        if self._stop.is_set() or self.orders.is_pending(states.AcquisitionState.MEASURE):
            return
        self._allow(self._longest_s())
        row = self._measuring().row()
        if self._driver is not None:
            self.counters.foreign_changes = self._foreign_before + self._driver.foreign_changes
        row = self._flagged(row)
        self._allow(float("inf"))
        if not self._hand_over(row):
            self.counters.unwritten += 1
        self.counters.rows += 1
        self._judge(row)
        self._had_fault = False
        self._backoff.reset()

    def _flagged(self, row: MeasuredRow) -> MeasuredRow:
        """Return a row with what its connection and its clock say of all of its carriers."""
        extra = self._epochs.judge(row.epoch_us, time.monotonic())
        self.counters.clock_jumps = self._epochs.jumps
        if self._had_fault and self.counters.rows:
            extra |= QualityFlag.RECONNECTED
        return replace(row, flags=row.flags | int(extra)) if extra else row

    def _judge(self, row: MeasuredRow) -> None:
        """Count a good row; raise when there has been none for three periods."""
        now_s = time.monotonic()
        if is_good(row):
            self._last_good_s = now_s
            self.counters.good_rows += 1
            self.counters.last_good_us = row.epoch_us
        elif now_s - self._last_good_s > self._watchdog_s:
            self.counters.watchdog += 1
            raise WatchdogError(f"{self._settings.resource} gave no good row for {now_s - self._last_good_s:.1f} s")

    def _pace(self) -> None:
        """Wait until the next row is due."""
        now_s = time.monotonic()
        period_s = self._settings.period_s
        if period_s <= 0.0:
            return
        if self._due_s is None:
            self._due_s = now_s
        if now_s > self._due_s + period_s:
            self.counters.overruns += 1
            self._due_s = now_s
        if self._due_s > now_s:
            self._allow(self._due_s - now_s + self._longest_s())
            self.orders.wait(self._due_s - now_s, states.AcquisitionState.MEASURE)
        self._due_s += period_s

    def _wait(self) -> None:
        """Close what is left of the session and wait."""
        self._close()
        wait_s = self._backoff.next_s()
        _TASK_LOG.info("analyzer %s: next attempt in %.1f s", self._settings.resource, wait_s)
        self._allow(wait_s + self._longest_s())
        self.orders.wait(wait_s, states.AcquisitionState.BACKOFF)

    def _rest(self) -> None:
        """Rest while the link is disabled."""
        self._allow(float("inf"))
        self.orders.wait(1.0, states.AcquisitionState.DISABLED)

    def _measuring(self) -> MeasuringCycle:
        if self._cycle is None:
            raise AnalyzerIOError("no session")
        return self._cycle

    def _longest_s(self) -> float:
        """Return a time that no action exceeds: the cycle with all its waits, resets, and every answer late."""
        waits_s = len(self._task.sweeps) * (self._settings.hold_s + 4.0 * self._settings.io_timeout_s)
        return 3.0 * self._cycle_s + waits_s + 3.0 * RESET_S

    def _allow(self, bound_s: float) -> None:
        """Set the time that the present action may take from now on."""
        self._bound_s = time.monotonic() + bound_s

    def _note(self, state: states.AcquisitionState, fault: Exception) -> None:
        self._had_fault = True
        self.counters.faults += 1
        self.counters.last_fault = str(fault)
        _TASK_LOG.warning("analyzer %s failed in %s: %s", self._settings.resource, state.name, fault)

    def _close(self) -> None:
        """Close the session, also one that the driver or the cycle uses."""
        if self._session is not None:
            self._session.close()
        self._session = self._driver = self._cycle = None


logger = logging.getLogger("service.frontend.station")

#: how often the station looks whether its threads live, s
_POLL_S = 0.2


class StationError(Exception):
    """A thread of the station died; the error that killed it is the cause."""


@dataclass(frozen=True, slots=True)
class StationSummary:
    """Summary of a run."""

    acquisition: AcquisitionCounters
    upload: UploadCounters
    #: rows that the service had not accepted when the run ended; they wait in the spool
    undelivered: int
    #: those of them that were not on the disk: lost with the process
    unwritten: int = 0


class MeasuringStation:
    """Measure a task on one analyzer for one spacecraft.

    Parameters
    ----------
    task : MeasurementTask
        Checked by the planner.
    acquisition : AcquisitionSettings
        Analyzer, pace, patience.
    upload : UploadSettings
        Destination, sizes, patience.
    client : ServiceClient
        Without retries of its own; the caller closes it.
    spool : Spool
        Where rows and traces wait for the service; the caller closes it.
    now_us : callable
        Present, microseconds UTC.
    make_backoff : callable
        Waiting times, one sequence for the analyzer and one for the service.
    """

    def __init__(
        self,
        task: MeasurementTask,
        acquisition: AcquisitionSettings,
        upload: UploadSettings,
        client: ServiceClient,
        spool: Spool,
        now_us: Callable[[], int],
        make_backoff: Callable[[], Backoff] = Backoff,
    ) -> None:
        self.task = task
        self.upload = upload
        self.spool = spool
        self.resource = acquisition.resource
        self._stop = threading.Event()
        self.uploader = Uploader(client, upload, spool, now_us, make_backoff())
        self.acquisition = Acquisition(
            task, acquisition, spool.append, now_us, self._stop, make_backoff(), spool.append_trace
        )

    @property
    def link_id(self) -> str:
        """Name of the link in reports."""
        return f"{self.upload.spacecraft_id}.{self.upload.source}"

    def stop(self) -> None:
        """Ask the station to end; safe to call from a signal handler and more than once."""
        self._stop.set()

    def run(self) -> StationSummary:
        """Run until `stop`; return what the run came to.

        Raises
        ------
        StationError
            One of the threads died.
        """
        measuring = _Worker(f"acquisition {self.link_id}", self.acquisition.run)
        sending = _Worker(f"uploader {self.link_id}", self.uploader.run)
        for worker in (measuring, sending):
            worker.start()
        while not self._stop.wait(_POLL_S):
            self.acquisition.poll()
            if not (measuring.is_alive() and sending.is_alive()):
                break
        self._stop.set()
        while measuring.is_alive():
            measuring.join(_POLL_S)
            self.acquisition.poll()
        self.uploader.finish()
        sending.join()
        for worker in (measuring, sending):
            if worker.error is not None:
                message = f"{worker.name} failed: {type(worker.error).__name__} {worker.error}"
                raise StationError(message) from worker.error
        return self._summary()

    def _summary(self) -> StationSummary:
        state = self.spool.state
        if state.waiting:
            logger.warning("%s: %d rows wait in the spool for the next start", self.link_id, state.waiting)
        return StationSummary(self.acquisition.counters, self.uploader.counters, state.waiting, state.held)


def run_stations(stations: Sequence[MeasuringStation]) -> list[StationSummary]:
    """Run several stations until each has been stopped; one that dies stops the others.

    Raises
    ------
    StationError
        A thread of one of them died.
    """
    summaries: dict[str, StationSummary] = {}

    def run(station: MeasuringStation) -> None:
        try:
            summaries[station.link_id] = station.run()
        finally:
            for other in stations:
                other.stop()

    workers = [_Worker(station.link_id, lambda station=station: run(station)) for station in stations]  # type: ignore[misc]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    for worker in workers:
        if worker.error is not None:
            raise worker.error
    return [summaries[station.link_id] for station in stations]


class _Worker(threading.Thread):
    """Thread that keeps the error that ended it."""

    def __init__(self, name: str, work: Callable[[], None]) -> None:
        super().__init__(name=name, daemon=True)
        self.error: Exception | None = None
        self._work = work

    def run(self) -> None:
        """Work; an error is kept for the station, which raises it."""
        try:
            self._work()
        except Exception as error:
            self.error = error
            logger.exception("thread %s failed; the front end stops", self.name)
