"""Rows from the spool to the service, until it has said that it keeps them.

Law of this file: a row leaves the spool only when the service accepted it, knew it already, or refused it by name; a
refusal is logged, counted and kept. Whatever else happens - no connection, no answer, 5xx, a wrong key, an unknown
plan - the same rows are sent again after a wait, with the same content: under the plan and with the figures that they
were sent with before, by this process or the one before it. So the service knows them again. Which rows go next stands
in `service.frontend.upload.plan_binding`, what an answer means in `service.frontend.upload.plan_binding`.

Evidence traces to the service, when no row waits: kept until they are accounted for, given up before they block.

A service that does not know traces (404) is left alone for a while; a trace that it cannot read is given up, counted
and logged, for evidence must not stand in the way of measurements.
"""

import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.client.backoff import Backoff
from service.client.problem import ProblemError, ServiceUnavailableError
from service.client.service_client import ServiceClient
from service.frontend.spool.disk import SpoolWarning
from service.frontend.spool.file import UploadLane
from service.frontend.spool.row import SpooledRow, SpooledTask, SpooledTrace
from service.frontend.spool.spool import Spool
from service.frontend.upload import plan_binding
from service.records.epoch import US_PER_S, format_epoch

#: a service that did not know traces is asked again after this time, s
_AGAIN_S = 600.0
#: decimals of a point on the wire, dB
_DECIMALS = 2
_FORBIDDEN, _UNKNOWN, _TOO_LARGE, _UNREADABLE = 403, 404, 413, 422


@dataclass(slots=True)
class TraceCounters:
    """Counters of the traces."""

    sent: int = 0
    #: given up because the service rejected their content or their epochs
    refused: int = 0


class TraceSender:
    """Send traces of a spool.

    Parameters
    ----------
    client : ServiceClient
        Without retries of its own.
    spacecraft_id, source : str
        Destination.
    spool : Spool
        Where the traces wait.
    batch : int
        Traces of one request at most.
    elapsed_s : callable
        Clock that only runs forward, s.
    """

    def __init__(
        self,
        client: ServiceClient,
        spacecraft_id: str,
        source: str,
        spool: Spool,
        batch: int,
        elapsed_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.counters = TraceCounters()
        self._client = client
        self._spacecraft_id = spacecraft_id
        self._source = source
        self._spool = spool
        self._batch = batch
        self._elapsed_s = elapsed_s
        self._from_s = float("-inf")

    def is_due(self) -> bool:
        """Return whether a trace waits and the service may accept it."""
        return self._spool.traces_waiting > 0 and self._elapsed_s() >= self._from_s

    def patience_s(self) -> float:
        """Return how long a wait for rows may be before traces are due, s."""
        return max(self._from_s - self._elapsed_s(), 0.0) if self._spool.traces_waiting else float("inf")

    def send(self) -> None:
        """Send the oldest traces once.

        Raises
        ------
        ServiceUnavailableError
            No answer, or one that does not account for the traces: they are to be sent again.
        ProblemError
            A refusal that has nothing to do with the traces, for example of the key.
        """
        traces = self._spool.traces(self._batch)
        if not traces:
            return
        try:
            reply = self._client.post_traces(self._spacecraft_id, self._source, [_as_json(each) for each in traces])
        except ProblemError as problem:
            self._face(problem, traces)
            return
        if not _accounts_for(reply, len(traces)):
            message = f"answer does not account for {len(traces)} traces: {str(reply)[:200]}"
            raise ServiceUnavailableError(message)
        refused = len(reply.get("refused", ()))
        self.counters.sent += len(traces) - refused
        self.counters.refused += refused
        self._spool.settle_traces(traces)

    def _face(self, problem: ProblemError, traces: list[SpooledTrace]) -> None:
        """Act on traces that were refused as a whole."""
        if problem.status == _UNKNOWN:
            self._from_s = self._elapsed_s() + _AGAIN_S
            logger.info("the service does not accept traces (%s); next attempt in %.0f s", problem, _AGAIN_S)
        elif problem.status in {_TOO_LARGE, _UNREADABLE} and len(traces) > 1:
            self._batch = 1  # which one it is shows when they go alone
        elif problem.status in {_TOO_LARGE, _UNREADABLE}:
            self.counters.refused += 1
            logger.error(
                "trace of %s is dropped, the service rejects it: %s", format_epoch(traces[0].epoch_us), problem
            )
            self._spool.settle_traces(traces)
        else:
            raise problem


def _as_json(trace: SpooledTrace) -> dict[str, Any]:
    levels = np.round(np.frombuffer(trace.power_dbm, dtype="<f4").astype(np.float64), _DECIMALS).tolist()
    return {
        "epoch": format_epoch(trace.epoch_us),
        "sweep": trace.sweep,
        "start_hz": trace.start_hz,
        "step_hz": trace.step_hz,
        "rbw_hz": trace.rbw_hz,
        "enbw_hz": trace.enbw_hz,
        "sweep_time_s": trace.sweep_time_s,
        "power_dbm": [level if math.isfinite(level) else None for level in levels],
    }


def _accounts_for(reply: Any, traces: int) -> bool:
    """Return whether an answer accounts for every trace."""
    try:
        return int(reply["accepted"]) + int(reply["duplicates"]) + len(reply.get("refused", ())) == traces
    except (KeyError, TypeError, ValueError):
        return False


logger = logging.getLogger("service.frontend.upload.uploader")

#: a service that did not know the figures beside the powers is asked again after this time, s
_DETAILS_AGAIN_S = 600.0
#: longest wait between two looks at an empty spool, s
_POLL_S = 5.0


@dataclass(frozen=True, slots=True)
class UploadSettings:
    """Destination, size of batches and patience."""

    spacecraft_id: str
    source: str
    #: rows of one request at most
    batch_rows: int = 100
    #: shortest time between requests that are not full, s; a row after a pause is sent at once
    batch_s: float = 0.05
    #: age at which the service calls a row late, s
    lateness_s: float = 300.0
    #: time to deliver the rest after a stop while the service takes it, s; what is left stays in the spool
    drain_s: float = 5.0
    #: evidence traces of one request at most
    batch_traces: int = 4


@dataclass(slots=True)
class UploadCounters:
    """Counters of the rows and requests."""

    accepted: int = 0
    duplicates: int = 0
    late: int = 0
    refused: int = 0
    requests: int = 0
    #: requests that carried the backfill lane, a part of the requests
    backfill_requests: int = 0
    #: attempts that failed and were repeated
    failures: int = 0
    last_failure: str = ""
    #: stands while the service refuses the rows by the key that they come with; they stay in the spool
    not_accepted: SpoolWarning | None = None
    #: when the service last accounted for rows, microseconds UTC
    last_good_us: int | None = None


class Uploader:
    """The loop that empties a spool.

    Parameters
    ----------
    client : ServiceClient
        Without retries of its own.
    settings : UploadSettings
        Destination, sizes, patience.
    spool : Spool
        Where the rows wait.
    now_us : callable
        Present, microseconds UTC: what is late is judged by it.
    backoff : Backoff
        Waiting times after failures.
    """

    def __init__(
        self,
        client: ServiceClient,
        settings: UploadSettings,
        spool: Spool,
        now_us: Callable[[], int],
        backoff: Backoff | None = None,
    ) -> None:
        self.counters = UploadCounters()
        self._client = client
        self._settings = settings
        self._spool = spool
        self._now_us = now_us
        self._backoff = backoff or Backoff()
        #: in the order in which they are looked into for rows: the one served last comes second
        self._lanes = tuple(UploadLane)
        self._traces = TraceSender(client, settings.spacecraft_id, settings.source, spool, settings.batch_traces)
        self._batch_rows = settings.batch_rows
        #: rows of the next request, when a row at fault stands behind them
        self._part: int | None = None
        self._bindings: dict[tuple[str, ...], plan_binding.PlanBinding] = {}
        self._details_from_s = float("-inf")
        #: epochs of waiting rows that were sent without the figures beside the powers
        self._bare: set[int] = set()
        #: whether rows may wait that were sent by the process before
        self._is_resuming = True
        self._finishing = threading.Event()
        self._deadline_s = float("inf")
        self._sent_at_s = float("-inf")
        self._is_down = False

    @property
    def waiting(self) -> int:
        """Rows that the service has not taken yet."""
        return self._spool.waiting

    @property
    def traces(self) -> TraceCounters:
        """Return the counters of the evidence traces."""
        return self._traces.counters

    @property
    def is_down(self) -> bool:
        """Return whether the last attempt failed."""
        return self._is_down

    def run(self) -> None:
        """Deliver until `finish` has been called and nothing waits, the service fails, or the time is over."""
        while self._await_work():
            lane, rows = self._batch()
            if rows:
                self._deliver(lane, rows)
            elif self._finishing.is_set():
                return
            elif self._traces.is_due():
                self._send_traces()

    def finish(self) -> None:
        """Deliver what waits while the service takes it, within ``drain_s``, then end `run`."""
        self._deadline_s = time.monotonic() + self._settings.drain_s
        self._finishing.set()
        self._spool.wake()

    def _await_work(self) -> bool:
        """Wait for rows, and for company where requests would follow too closely; False at the end."""
        spool = self._spool
        if not spool.waiting:
            if self._finishing.is_set():
                return False
            if not self._traces.is_due():
                # bounded: a disk that failed shows its rows when it is looked at again
                spool.await_rows(1, min(self._traces.patience_s(), _POLL_S))
        due_s = self._sent_at_s + self._settings.batch_s
        remaining_s = due_s - time.monotonic()
        if remaining_s > 0.0 and not self._finishing.is_set():
            spool.await_rows(self._batch_rows, remaining_s)
        return time.monotonic() < self._deadline_s

    def _batch(self) -> tuple[UploadLane, list[SpooledRow]]:
        """Return the rows whose turn it is; they stay in the spool until they are settled."""
        cutoff_us = self._now_us() - round(self._settings.lateness_s * US_PER_S)
        for lane in self._lanes:
            rows = self._spool.batch(lane, cutoff_us, self._part or self._batch_rows)
            if rows:
                return lane, rows
        return self._lanes[0], []

    def _deliver(self, lane: UploadLane, rows: list[SpooledRow]) -> None:
        """Send one batch once; settle its rows or wait."""
        try:
            binding = self._binding(rows[0].task)
            reply = self._post(lane, rows, binding)
        except ServiceUnavailableError as error:
            self._fail(f"service does not answer: {error}", error.retry_after_s)
        except plan_binding.PlanMismatchError as error:
            self._serve_other(lane)  # rows of another task may wait in the other lane
            self._fail(f"no carrier plan of {self._settings.spacecraft_id}: {error}", None)
        except ProblemError as problem:
            self._face(problem, lane, rows)
        else:
            self._settle(reply, lane, rows)

    def _post(self, lane: UploadLane, rows: Sequence[SpooledRow], binding: plan_binding.PlanBinding) -> Any:
        self._sent_at_s = time.monotonic()
        self.counters.requests += 1
        self.counters.backfill_requests += lane is UploadLane.BACKFILL
        if self._sent_at_s < self._details_from_s:
            self._bare.update(each.row.epoch_us for each in rows)
        return self._client.post_measurements(
            self._settings.spacecraft_id,
            binding.plan_id,
            [binding.as_json(each.row, with_details=each.row.epoch_us not in self._bare) for each in rows],
            source=self._settings.source,
            first_seq=rows[0].seq,
        )

    def _settle(self, reply: Any, lane: UploadLane, rows: list[SpooledRow]) -> None:
        """Count what the service says and let the rows go, if it accounts for all of them."""
        receipt = plan_binding.read_receipt(reply, len(rows))
        if receipt is None:
            self._fail(f"answer does not account for {len(rows)} rows: {str(reply)[:200]}", None)
            return
        self._recovered()
        self.counters.accepted += receipt.accepted
        self.counters.duplicates += receipt.duplicates
        self.counters.late += receipt.late
        self._let_go(lane, rows, receipt.refused)

    def _let_go(self, lane: UploadLane, rows: list[SpooledRow], refused: dict[int, tuple[str, str]]) -> None:
        """Take settled rows off the spool; the refused ones are logged and kept apart."""
        for position, (code, detail) in refused.items():
            self.counters.refused += 1
            logger.error("row %s of %s refused: %s: %s", rows[position].seq, _at(rows[position]), code, detail)
        self.counters.last_good_us = self._now_us()
        self._spool.settle(rows, refused)
        self._bare.difference_update(each.row.epoch_us for each in rows)
        if self._is_resuming and not self._spool.waiting:
            self._is_resuming = False
            self._bindings.clear()
        self._serve_other(lane)
        self._part = None

    def _serve_other(self, lane: UploadLane) -> None:
        """Look into the other lane first."""
        self._lanes = tuple(sorted(UploadLane, key=lambda each: each is lane))

    def _face(self, problem: ProblemError, lane: UploadLane, rows: list[SpooledRow]) -> None:
        """Act on a batch that was refused as a whole."""
        verdict, position = plan_binding.judge(problem, len(rows))
        if verdict is plan_binding.BatchAction.SHORTER:
            self._batch_rows = max(1, len(rows) // 2)
            logger.warning(
                "the service refuses %d rows in one request as too long; %d rows a request from now on",
                len(rows),
                self._batch_rows,
            )
        elif verdict is plan_binding.BatchAction.WITHOUT_DETAILS and self._sent_at_s >= self._details_from_s:
            self._details_from_s = self._sent_at_s + _DETAILS_AGAIN_S
            logger.warning(
                "the service does not accept details beside the powers (%s): rows are sent without them", problem
            )
        elif verdict is plan_binding.BatchAction.PARTED and position > 0:
            self._part = position  # a batch has one first_seq and no holes
        elif verdict is plan_binding.BatchAction.PARTED:
            self._let_go(lane, rows[:1], {0: (problem.code, problem.detail)})
        else:
            if verdict is plan_binding.BatchAction.NEW_PLAN:
                self._is_resuming = False
                self._bindings.clear()
            if problem.status == _FORBIDDEN and self.counters.not_accepted is None:
                self.counters.not_accepted = SpoolWarning("upload.not_accepted", str(problem), self._now_us())
            self._fail(f"service refuses the batch: {problem}", None)

    def _binding(self, task: SpooledTask) -> plan_binding.PlanBinding:
        """Return the plan under which rows of a task go, fetched once."""
        task_ids = task.carrier_ids
        if task_ids not in self._bindings:
            kept = self._spool.plan_of(task) if self._is_resuming else None
            binding = plan_binding.find_binding(self._client, self._settings.spacecraft_id, task_ids, kept)
            if binding.plan_id != kept:
                self._spool.keep_plan(task, binding.plan_id)
            self._bindings[task_ids] = binding
            _log_binding(binding)
        return self._bindings[task_ids]

    def _send_traces(self) -> None:
        """Send some traces; a service that is away is waited for."""
        try:
            self._traces.send()
        except ServiceUnavailableError as error:
            self._fail(f"service does not answer: {error}", error.retry_after_s)
        except ProblemError as problem:
            self._fail(f"service refuses traces: {problem}", None)
        else:
            self._recovered()

    def _fail(self, what: str, retry_after_s: float | None) -> None:
        """Count and log a failed attempt, and wait before the next one; after `finish` there is none."""
        self._is_down = True
        self.counters.failures += 1
        self.counters.last_failure = what
        if self._finishing.is_set():
            self._deadline_s = float("-inf")
            logger.warning("%s; %d rows stay in the spool", what, self._spool.waiting)
            return
        wait_s = max(self._backoff.next_s(), retry_after_s or 0.0)
        logger.warning("%s; %d rows wait, next attempt in %.1f s", what, self._spool.waiting, wait_s)
        self._finishing.wait(wait_s)

    def _recovered(self) -> None:
        """Log once that the service answers again."""
        if self._is_down:
            logger.info("the service answers again; %d rows wait to be sent", self._spool.waiting)
        self._is_down = False
        self.counters.not_accepted = None
        self._backoff.reset()


def _log_binding(binding: plan_binding.PlanBinding) -> None:
    """Log the plan in use and the carriers missing on either side."""
    logger.info("rows are sent by carrier plan %d with %d carriers", binding.plan_id, binding.positions.size)
    if binding.unknown:
        logger.warning("carriers of the task that the plan lacks are not sent: %s", ", ".join(binding.unknown))
    if binding.unmeasured:
        logger.warning("carriers of the plan that the task lacks are sent as null: %s", ", ".join(binding.unmeasured))


def _at(each: SpooledRow) -> str:
    return format_epoch(each.row.epoch_us)
