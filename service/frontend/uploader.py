"""Rows to the service: in order, in batches, until the service has said that it keeps them.

Law of this file: a row leaves the queue only when the service accepted it, knew it already, or refused it by name; a
refusal is logged and counted. Whatever else happens - no connection, no answer, 5xx, a wrong key, an unknown plan - the
same batch is sent again after a wait. Repeating is safe: the service knows a row by source and epoch. When the queue is
full, `put` blocks and so holds the sweeping back.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

from service.client.backoff import Backoff
from service.client.problem import ProblemError, ServiceUnavailableError
from service.client.service_client import ServiceClient
from service.frontend.evaluation import MeasuredRow
from service.frontend.plan_binding import PlanBinding, PlanMismatchError, bind_plan
from service.records.epoch import format_epoch

logger = logging.getLogger("service.frontend.uploader")

#: HTTP status of a body that is too long
TOO_LARGE = 413
#: what a blocked `put` sleeps between looks at the stop, s
_LOOK_S = 0.1


@dataclass(frozen=True, slots=True)
class UploadSettings:
    """Size of batches and patience."""

    spacecraft_id: str
    source: str
    #: rows of one request at most
    batch_rows: int = 100
    #: shortest time between requests that are not full, s; a row after a pause is sent at once
    batch_s: float = 0.05
    #: rows kept while the service is away; then sweeping waits
    queue_rows: int = 10_000
    #: time to deliver the rest after a stop, s
    drain_s: float = 5.0


@dataclass(slots=True)
class UploadCounters:
    """What became of the rows."""

    accepted: int = 0
    duplicates: int = 0
    late: int = 0
    refused: int = 0
    requests: int = 0
    #: attempts that failed and were repeated
    failures: int = 0
    last_failure: str = ""


class _Numbered(NamedTuple):
    """A row and its sequence number."""

    seq: int
    row: MeasuredRow


class Uploader:
    """Bounded queue of rows and the loop that empties it.

    Parameters
    ----------
    client : ServiceClient
        Without retries of its own.
    settings : UploadSettings
        Destination, sizes, patience.
    task_ids : sequence of str
        Carriers of the rows, in their order.
    stop : threading.Event
        After it no row is taken that finds no room within ``drain_s``.
    backoff : Backoff
        Waiting times after failures.
    """

    def __init__(
        self,
        client: ServiceClient,
        settings: UploadSettings,
        task_ids: Sequence[str],
        stop: threading.Event,
        backoff: Backoff | None = None,
    ) -> None:
        self.counters = UploadCounters()
        self._client = client
        self._settings = settings
        self._task_ids = tuple(task_ids)
        self._stop = stop
        self._backoff = backoff or Backoff()
        self._queue: deque[_Numbered] = deque()
        self._changed = threading.Condition()
        self._next_seq = 1
        self._batch_rows = settings.batch_rows
        self._binding: PlanBinding | None = None
        self._is_finishing = False
        self._deadline_s = float("inf")
        self._sent_at_s = float("-inf")
        self._is_down = False

    @property
    def waiting(self) -> int:
        """Rows that the service has not taken yet."""
        return len(self._queue)

    def put(self, row: MeasuredRow) -> bool:
        """Queue a row; blocks while the queue is full. False: a stop left no room for it."""
        with self._changed:
            if len(self._queue) >= self._settings.queue_rows and not self._wait_for_room():
                logger.error("row of %s is lost: no room %g s after the stop", _at(row), self._settings.drain_s)
                return False
            self._queue.append(_Numbered(self._next_seq, row))
            self._next_seq += 1
            self._changed.notify_all()
        return True

    def run(self) -> None:
        """Deliver rows until `finish` has been called and the queue is empty, or its time is over."""
        while self._bind_or_wait() and self._await_rows():
            self._deliver(self._batch())

    def finish(self) -> None:
        """Deliver what is queued within ``drain_s``, then end `run`."""
        with self._changed:
            self._is_finishing = True
            self._deadline_s = time.monotonic() + self._settings.drain_s
            self._changed.notify_all()

    def _wait_for_room(self) -> bool:
        """Wait, with the condition held, until the queue has room."""
        logger.warning("queue is full with %d rows: sweeping waits for the service", len(self._queue))
        stopped_at_s: float | None = None
        while len(self._queue) >= self._settings.queue_rows:
            self._changed.wait(_LOOK_S)
            if self._stop.is_set():
                stopped_at_s = stopped_at_s or time.monotonic()
                if time.monotonic() - stopped_at_s > self._settings.drain_s:
                    return False
        logger.info("queue has room again: sweeping goes on")
        return True

    def _await_rows(self) -> bool:
        """Wait for rows, and for company where requests would follow too closely; False at the end."""
        with self._changed:
            while not self._queue:
                if self._is_finishing:
                    return False
                self._changed.wait()
            due_s = self._sent_at_s + self._settings.batch_s
            while not self._is_finishing and len(self._queue) < self._batch_rows:
                remaining_s = due_s - time.monotonic()
                if remaining_s <= 0.0:
                    break
                self._changed.wait(remaining_s)
        return time.monotonic() < self._deadline_s

    def _batch(self) -> list[_Numbered]:
        """Return the oldest rows; they stay queued until they are settled."""
        with self._changed:
            return list(islice(self._queue, self._batch_rows))

    def _deliver(self, batch: list[_Numbered]) -> None:
        """Send one batch once; settle its rows or wait."""
        binding = self._binding
        if binding is None:
            return
        self._sent_at_s = time.monotonic()
        self.counters.requests += 1
        try:
            reply = self._client.post_measurements(
                self._settings.spacecraft_id,
                binding.plan_id,
                [binding.as_json(numbered.row) for numbered in batch],
                source=self._settings.source,
                first_seq=batch[0].seq,
            )
        except ServiceUnavailableError as error:
            self._fail(f"service does not answer: {error}", error.retry_after_s)
        except ProblemError as problem:
            self._face(problem, batch)
        else:
            self._settle(reply, batch)

    def _settle(self, reply: Any, batch: list[_Numbered]) -> None:
        """Count what the service says and take the rows off the queue, if it accounts for all of them."""
        counted = _counted(reply, len(batch))
        if counted is None:
            self._fail(f"answer does not account for {len(batch)} rows: {str(reply)[:200]}", None)
            return
        accepted, duplicates, late, refusals = counted
        self._recovered()
        self.counters.accepted += accepted
        self.counters.duplicates += duplicates
        self.counters.late += late
        for index, code, detail in refusals:
            self._log_refusal(batch[index], code, detail)
        self._take_off(len(batch))

    def _face(self, problem: ProblemError, batch: list[_Numbered]) -> None:
        """Act on a batch that was refused as a whole."""
        guilty = _rows_at_fault(problem, len(batch))
        if problem.status == TOO_LARGE and self._batch_rows > 1:
            self._batch_rows = max(1, self._batch_rows // 2)
            logger.warning("service finds %d rows too long, %d from now on", len(batch), self._batch_rows)
        elif guilty:
            self._drop(guilty, batch, problem)
        else:
            if problem.code == "plan.unknown":
                self._binding = None
            self._fail(f"service refuses the batch: {problem}", None)

    def _drop(self, guilty: list[int], batch: list[_Numbered], problem: ProblemError) -> None:
        """Take rows that the service cannot read off the queue; the others are sent again, in one piece up to them."""
        first = guilty[0]
        if first > 0:
            # The rows before the first bad one go alone: a batch has one first_seq and no holes.
            self._deliver(batch[:first])
            return
        self._log_refusal(batch[0], problem.code, problem.detail)
        self._take_off(1)

    def _take_off(self, rows: int) -> None:
        """Remove settled rows from the head of the queue."""
        with self._changed:
            for _ in range(rows):
                self._queue.popleft()
            self._changed.notify_all()

    def _log_refusal(self, numbered: _Numbered, code: str, detail: str) -> None:
        """Count and log one refused row."""
        self.counters.refused += 1
        logger.error("row %d of %s refused: %s: %s", numbered.seq, _at(numbered.row), code, detail)

    def _bind_or_wait(self) -> bool:
        """Fetch the carrier plan if there is none; False when the time after `finish` is over."""
        while self._binding is None:
            if self._is_over():
                return False
            try:
                self._binding = bind_plan(self._client.carriers(self._settings.spacecraft_id), self._task_ids)
            except ServiceUnavailableError as error:
                self._fail(f"service does not answer: {error}", error.retry_after_s)
            except (ProblemError, PlanMismatchError) as error:
                self._fail(f"no carrier plan of {self._settings.spacecraft_id}: {error}", None)
            else:
                self._recovered()
                _log_binding(self._binding)
        return not self._is_over()

    def _is_over(self) -> bool:
        """Return whether the time to deliver is over, or nothing is left to deliver after `finish`."""
        return time.monotonic() >= self._deadline_s or (self._is_finishing and not self._queue)

    def _fail(self, what: str, retry_after_s: float | None) -> None:
        """Count and log a failed attempt, and wait before the next one."""
        self._is_down = True
        self.counters.failures += 1
        self.counters.last_failure = what
        wait_s = max(self._backoff.next_s(), retry_after_s or 0.0)
        logger.warning("%s; %d rows wait, next attempt in %.1f s", what, len(self._queue), wait_s)
        end_s = time.monotonic() + wait_s
        with self._changed:
            was_finishing = self._is_finishing
            while (remaining_s := min(end_s, self._deadline_s) - time.monotonic()) > 0.0:
                self._changed.wait(remaining_s)
                if self._is_finishing and not was_finishing:
                    break  # one attempt at once when the stop comes

    def _recovered(self) -> None:
        """Say that the service answers again."""
        if self._is_down:
            logger.info("service answers again; %d rows waited", len(self._queue))
        self._is_down = False
        self._backoff.reset()


def _counted(reply: Any, rows: int) -> tuple[int, int, int, list[tuple[int, str, str]]] | None:
    """Return accepted, duplicates, late and refusals of a reply; None when it does not account for every row."""
    try:
        accepted, duplicates, late = int(reply["accepted"]), int(reply["duplicates"]), int(reply.get("late", 0))
        refusals = [(int(each["index"]), str(each["code"]), str(each["detail"])) for each in reply["refused"]]
    except (AttributeError, KeyError, TypeError, ValueError):
        return None
    is_complete = accepted + duplicates + len(refusals) == rows and all(0 <= each[0] < rows for each in refusals)
    return (accepted, duplicates, late, refusals) if is_complete else None


def _rows_at_fault(problem: ProblemError, rows: int) -> list[int]:
    """Return the places of the rows that a problem's pointers name, lowest first."""
    places = set()
    for error in problem.errors:
        parts = str(error.get("pointer", "")).removeprefix("#").split("/")
        if len(parts) > 2 and parts[1] == "measurements" and parts[2].isdigit() and int(parts[2]) < rows:
            places.add(int(parts[2]))
    return sorted(places)


def _log_binding(binding: PlanBinding) -> None:
    """Say which plan is in use and what is missing on either side."""
    logger.info("plan %d with %d carriers", binding.plan_id, binding.places.size)
    if binding.unknown:
        logger.warning("not in the plan, not sent: %s", ", ".join(binding.unknown))
    if binding.unmeasured:
        logger.warning("in the plan, not in the task, sent as null: %s", ", ".join(binding.unmeasured))


def _at(row: MeasuredRow) -> str:
    """Return the epoch of a row as text."""
    return format_epoch(row.epoch_us)
