"""An archive that a station already has, sent to the service: in pieces, resumable, each row accounted for.

Examples
--------
::

    with ServiceClient("http://127.0.0.1:8000", key) as client:
        report = send_archive(client, ArchiveOrder(Path("levels.csv"), "yamal-202", "sa-1"))
    print(report["accepted"], report["duplicates"], report["refused"])

Law of this file: a row counts as sent when the service has accounted for it. An interruption at any point costs at most
the repetition of one request, and the service knows its rows again.

State of sending an archive, kept in a small file beside it, and the refused rows.

Law of this file: the state is replaced as a whole and written through after every answer of the service; it belongs to
one content of the file (SHA-256) and one destination. What stands in the file of refused rows beyond what the state
knows is cut off when the sending goes on.
"""

import csv
import hashlib
import io
import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

from service.client.backoff import Backoff
from service.client.problem import ClientError, ProblemError, ServiceUnavailableError
from service.client.service_client import ServiceClient
from service.frontend.backfill.columns import (
    ArchiveError,
    CellError,
    FileColumns,
    match_columns,
    read_epoch,
    read_levels,
)
from service.frontend.backfill.reader import ArchiveFileReader, FileRow, open_archive, sha256_of
from service.frontend.backfill.survey import FaultGroups, Survey
from service.frontend.upload.plan_binding import BatchAction, BatchReply, judge, read_receipt
from service.records.csv_guard import guarded
from service.records.epoch import format_epoch, is_leap_second

_FORMAT = 1


@dataclass(slots=True)
class SendCounters:
    """Counters of the rows of a file, over all runs."""

    #: rows of the file that are settled, with any outcome
    rows: int = 0
    accepted: int = 0
    duplicates: int = 0
    late: int = 0
    #: refused by the service by name
    refused: int = 0
    #: rows whose cells mean nothing; never sent
    unreadable: int = 0
    #: rows of other sources; never sent
    other_sources: dict[str, int] = field(default_factory=dict)

    @property
    def kept_back(self) -> int:
        """Rows in the file of refused rows."""
        return self.refused + self.unreadable


@dataclass(frozen=True, slots=True)
class Destination:
    """Destination of a file: service, spacecraft, source and chosen rows."""

    sha256: str
    service: str
    spacecraft_id: str
    source: str
    from_source: str
    #: stated layout of a foreign file; empty for our own
    layout: str = ""

    @property
    def key(self) -> str:
        """Sixteen hexadecimal digits that stand for all of it."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()[:16]


class SendState:
    """State of one sending.

    Parameters
    ----------
    path : Path
        The archive.
    destination : Destination
        Where it goes.
    folder : Path, optional
        Where the state and the refused rows are kept; default: beside the archive.
    """

    def __init__(self, path: Path, destination: Destination, folder: Path | None = None) -> None:
        position = folder or path.parent
        self.path = position / f"{path.name}.{destination.key}.send.json"
        self.refused_path = position / f"{path.name}.refused.csv"
        self.counters = SendCounters()
        self.is_complete = False
        #: under which the rows go; None before the first
        self.plan_id: int | None = None
        self._destination = destination
        self._refused_bytes = 0

    def load(self) -> bool:
        """Read what an earlier run left; False when there is nothing."""
        try:
            said: dict[str, Any] = json.loads(self.path.read_text())
        except FileNotFoundError:
            return False
        except (OSError, ValueError) as error:
            raise ArchiveError(f"{self.path} cannot be read: {error}; remove it to begin again") from error
        if said.get("format") != _FORMAT or said.get("destination") != asdict(self._destination):
            raise ArchiveError(f"{self.path} belongs to another upload; remove it to begin again")
        names = {each.name for each in fields(SendCounters)}
        self.counters = SendCounters(**{name: value for name, value in said["counters"].items() if name in names})
        self.is_complete = bool(said["is_complete"])
        self.plan_id = said.get("plan_id")
        self._refused_bytes = int(said["refused_bytes"])
        return True

    def begin(self) -> None:
        """Make the places ready; what was refused beyond the state's knowledge is cut off."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.refused_path.exists():
            if self._refused_bytes:
                os.truncate(self.refused_path, self._refused_bytes)
            else:
                self.refused_path.unlink()

    def refuse(self, header: Sequence[str], rows: Sequence[tuple[int, str, str, Sequence[Any]]]) -> None:
        """Write rows (line, code, words, cells) to the file of refused rows."""
        if not rows:
            return
        text = io.StringIO()
        writer = csv.writer(text)
        if not self._refused_bytes:
            writer.writerow(("line", "code", "detail", *map(guarded, header)))
        writer.writerows((line, code, detail, *map(_cell, cells)) for line, code, detail, cells in rows)
        with self.refused_path.open("ab") as file:
            file.write(text.getvalue().encode())
            file.flush()
            os.fsync(file.fileno())
            self._refused_bytes = file.tell()

    def save(self) -> None:
        """Write the state through to the disk, in place of the one before."""
        document = {
            "format": _FORMAT,
            "destination": asdict(self._destination),
            "counters": asdict(self.counters),
            "refused_bytes": self._refused_bytes,
            "is_complete": self.is_complete,
            "plan_id": self.plan_id,
        }
        others = self.path.with_name(self.path.name + ".new")
        with others.open("w") as file:
            json.dump(document, file)
            file.flush()
            os.fsync(file.fileno())
        others.replace(self.path)


def _cell(value: Any) -> Any:
    """Return a cell as it is written: a number as it is, a text that a spreadsheet would compute guarded."""
    try:
        float(value)
    except (TypeError, ValueError):
        return guarded(value) if isinstance(value, str) else value
    return value


#: code of a row whose cells mean nothing
UNREADABLE = "row.unreadable"


class SendInterruptedError(ClientError):
    """The service did not take the rest; the same order continues where it stopped."""


@dataclass(frozen=True, slots=True)
class ArchiveOrder:
    """Order to send a file of measurements to one spacecraft and source."""

    path: Path
    spacecraft_id: str
    source: str
    #: only rows that the file gives to this source; None: those of ``source``, and those without a source
    from_source: str | None = None
    #: refuse a file with columns that are no carrier of the plan, instead of leaving them out
    refuse_unknown_columns: bool = False
    batch_rows: int = 1000
    #: longest wait for a service that does not answer, s
    patience_s: float = 600.0
    #: where state and refused rows are kept; None: beside the file
    folder: Path | None = None
    #: reads the file; archives of other formats come with readers of their own
    open_file: Callable[[Path], ArchiveFileReader] = open_archive
    #: stated layout of a foreign file: under another one the same file is sent again from its beginning
    layout: str = ""


class Progress(NamedTuple):
    """Progress of sending a file."""

    #: read of the file, in bytes or rows
    done: int
    total: int
    #: rows settled so far
    rows: int


class _Row(NamedTuple):
    """A row that can be sent."""

    file_row: FileRow
    epoch_us: int
    levels: list[float | None]
    #: the cell of an instant within a leap second, which has no microsecond of its own
    leap_epoch: str | None

    def as_json(self) -> dict[str, Any]:
        """Return the row as the contract has it."""
        return {"epoch": self.leap_epoch or format_epoch(self.epoch_us), "power_dbm": self.levels}


class _Unreadable(NamedTuple):
    """A row that cannot be sent."""

    file_row: FileRow
    kind: str
    detail: str


class _Foreign(NamedTuple):
    """A row of another source."""

    source: str


def survey_archive(client: ServiceClient, order: ArchiveOrder) -> tuple[Survey, dict[str, Any]]:
    """Return the survey of a file, and its columns and rows of other sources for a report; nothing is sent."""
    with closing(order.open_file(order.path)) as archive:
        _, columns = _plan_columns(client, order, archive)
        survey = Survey(columns.plan_ids)
        foreign: dict[str, int] = {}
        for each in _judged(archive, columns, order):
            if isinstance(each, _Row):
                survey.add(each.epoch_us, each.levels)
            elif isinstance(each, _Foreign):
                foreign[each.source] = foreign.get(each.source, 0) + 1
            else:
                survey.faults.add(each.kind, each.file_row.line, each.detail)
    return survey, {"other_sources": foreign, "columns": _reported(columns)}


def check_archive(client: ServiceClient, order: ArchiveOrder, now_us: int) -> dict[str, Any]:
    """Return a preview of sending: rows, span, gaps, levels, columns, sources and grouped faults; nothing is sent."""
    survey, report = survey_archive(client, order)
    return {"file": str(order.path), **survey.as_document(now_us), **report}


def send_archive(
    client: ServiceClient,
    order: ArchiveOrder,
    on_progress: Callable[[Progress], None] = lambda _: None,
    backoff: Backoff | None = None,
) -> dict[str, Any]:
    """Send an archive, or the rest of it, and return what became of its rows over all runs.

    Raises
    ------
    ArchiveError
        The file cannot be sent as it is.
    SendInterruptedError
        The service did not answer for longer than the order's patience; the next call goes on.
    ProblemError
        The service refuses the whole request, for example the key or the spacecraft.
    """
    begun_s = time.monotonic()
    sha256, from_source = sha256_of(order.path), order.from_source or ""
    destination = Destination(sha256, client.service_url, order.spacecraft_id, order.source, from_source, order.layout)
    state = SendState(order.path, destination, order.folder)
    state.load()
    resumed_at = state.counters.rows
    faults = FaultGroups()
    with closing(order.open_file(order.path)) as archive:
        # rows that were sent before go again under the plan that they were sent under
        plan_id, columns = _plan_columns(client, order, archive, state.plan_id)
        state.plan_id = plan_id
        if not state.is_complete:
            state.begin()
            state.save()
            sender = _Sender(client, order, state, plan_id, columns, backoff or Backoff())
            faults = sender.send(archive, on_progress)
    return {
        "file": str(order.path),
        "sha256": destination.sha256,
        **asdict(state.counters),
        "resumed_at": resumed_at,
        "columns": _reported(columns),
        "faults": faults.as_documents(),
        "refused_file": str(state.refused_path) if state.counters.kept_back else None,
        "state_file": str(state.path),
        "seconds": round(time.monotonic() - begun_s, 3),
    }


class _Sender:
    """Sends one file; see `send_archive`."""

    def __init__(
        self,
        client: ServiceClient,
        order: ArchiveOrder,
        state: SendState,
        plan_id: int,
        columns: FileColumns,
        backoff: Backoff,
    ) -> None:
        self._client = client
        self._order = order
        self._state = state
        self._plan_id = plan_id
        self._columns = columns
        self._backoff = backoff
        self._batch_rows = order.batch_rows
        #: of this run
        self._faults = FaultGroups()

    def send(self, archive: ArchiveFileReader, on_progress: Callable[[Progress], None]) -> FaultGroups:
        """Send what is left of a file; return the rows of this run that were kept back, by fault."""
        settled = self._state.counters.rows
        rows: list[_Row] = []
        seen: list[_Unreadable | _Foreign] = []
        for number, each in enumerate(_judged(archive, self._columns, self._order), start=1):
            if number <= settled:
                continue
            if isinstance(each, _Row):
                rows.append(each)
            else:
                seen.append(each)
            if len(rows) + len(seen) >= self._order.batch_rows:
                self._settle(rows, seen)
                on_progress(Progress(archive.done, archive.total, self._state.counters.rows))
                rows, seen = [], []
        self._state.is_complete = True
        self._settle(rows, seen)
        on_progress(Progress(archive.total, archive.total, self._state.counters.rows))
        return self._faults

    def _settle(self, rows: list[_Row], seen: list[_Unreadable | _Foreign]) -> None:
        """Deliver rows, note the others, and write the state."""
        counters = self._state.counters
        refused: list[tuple[int, str, str, Any]] = []
        for each in seen:
            if isinstance(each, _Foreign):
                counters.other_sources[each.source] = counters.other_sources.get(each.source, 0) + 1
            else:
                counters.unreadable += 1
                self._faults.add(each.kind, each.file_row.line, each.detail)
                refused.append((each.file_row.line, UNREADABLE, each.detail, each.file_row.cells))
        rest = rows
        while rest:
            part = rest[: self._batch_rows]
            sent, receipt = self._deliver(part)
            counters.accepted += receipt.accepted
            counters.duplicates += receipt.duplicates
            counters.late += receipt.late
            counters.refused += len(receipt.refused)
            for position, (code, detail) in receipt.refused.items():
                self._faults.add(code, part[position].file_row.line, detail)
                refused.append((part[position].file_row.line, code, detail, part[position].file_row.cells))
            rest = rest[sent:]
        self._state.refuse(self._columns.header, sorted(refused, key=lambda each: each[0]))
        counters.rows += len(rows) + len(seen)
        self._state.save()

    def _deliver(self, rows: list[_Row]) -> tuple[int, BatchReply]:
        """Send rows, or the first of them, until that is answered; return how many are settled, and how."""
        deadline_s = time.monotonic() + self._order.patience_s
        while True:
            try:
                receipt = self._post(rows)
            except ServiceUnavailableError as error:
                wait_s = max(self._backoff.next_s(), error.retry_after_s or 0.0)
                if time.monotonic() + wait_s > deadline_s:
                    raise SendInterruptedError(f"{error}; run the same command again to continue") from error
                time.sleep(wait_s)
            except ProblemError as problem:
                rows = self._shortened(problem, rows)
                if not rows:
                    return 1, BatchReply(0, 0, 0, {0: (problem.code, problem.detail)})
            else:
                self._backoff.reset()
                return len(rows), receipt

    def _shortened(self, problem: ProblemError, rows: list[_Row]) -> list[_Row]:
        """Return the rows to be sent after a batch was refused as a whole; none when its first row is the reason."""
        verdict, position = judge(problem, len(rows))
        if verdict is BatchAction.SHORTER:
            self._batch_rows = max(1, len(rows) // 2)
            return rows[: self._batch_rows]
        if verdict is BatchAction.PARTED:
            return rows[:position]
        raise problem

    def _post(self, rows: list[_Row]) -> BatchReply:
        """Send rows once; they take no sequence numbers, which belong to the front end."""
        reply = self._client.post_measurements(
            self._order.spacecraft_id, self._plan_id, [each.as_json() for each in rows], source=self._order.source
        )
        receipt = read_receipt(reply, len(rows))
        if receipt is None:
            raise ServiceUnavailableError(f"the answer does not account for {len(rows)} rows: {str(reply)[:200]}")
        return receipt


def _plan_columns(
    client: ServiceClient, order: ArchiveOrder, archive: ArchiveFileReader, plan_id: int | None = None
) -> tuple[int, FileColumns]:
    """Return the number of a plan, the newest by default, and what the file's columns are under it."""
    plan = client.carriers(order.spacecraft_id, plan_id)
    if not isinstance(plan.get("plan_id"), int):
        raise ArchiveError(f"{order.spacecraft_id} has no carrier plan yet")
    columns = match_columns(archive.header, [str(each["id"]) for each in plan["carriers"]])
    if columns.left_out and order.refuse_unknown_columns:
        raise ArchiveError(f"columns are no carrier of plan {plan['plan_id']}: {', '.join(columns.left_out)}")
    return int(plan["plan_id"]), columns


def _judged(
    archive: ArchiveFileReader, columns: FileColumns, order: ArchiveOrder
) -> Iterator[_Row | _Unreadable | _Foreign]:
    """Yield each row of a file as what it is."""
    wanted = {order.from_source} if order.from_source is not None else {order.source, ""}
    for file_row in archive.rows():
        cells = file_row.cells
        if file_row.fault is not None:
            yield _Unreadable(file_row, file_row.fault, file_row.detail)
            continue
        if len(cells) != len(columns.header):
            detail = f"{len(cells)} cells, the header has {len(columns.header)}"
            yield _Unreadable(file_row, detail, detail)
            continue
        source = "" if columns.source is None else str(cells[columns.source] or "").strip()
        if columns.source is not None and source not in wanted:
            yield _Foreign(source)
            continue
        try:
            cell = cells[columns.epoch]
            epoch_us, levels = read_epoch(cell), read_levels(cells, columns)
            text = str(cell).strip()
            yield _Row(file_row, epoch_us, levels, text if is_leap_second(text) and not text.isdecimal() else None)
        except CellError as error:
            yield _Unreadable(file_row, error.kind, str(error))


def _reported(columns: FileColumns) -> dict[str, list[str]]:
    """Return the columns as a report tells them."""
    return {
        "sent": [each.name for each in columns.carriers],
        "left_out": list(columns.left_out),
        "absent": list(columns.absent),
    }
