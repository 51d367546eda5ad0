"""Rows of an operator's files sent to the service: powers in resumable pieces, readings in repeatable ones.

A row of powers counts as sent when the service has accounted for it. An interruption at any point costs at most the
repetition of one request, and the service knows its rows again. The state is replaced as a whole and written through
after every answer; it belongs to one content of the file (SHA-256), one statement and one destination.
"""

import csv
import hashlib
import io
import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from service.client.backoff import Backoff
from service.client.problem import ClientError, ProblemError, ServiceUnavailableError
from service.client.service_client import ServiceClient
from service.core.arrays import FloatArray
from service.formats.foreign.columns import AXES, ReadingsStatement, TableRows, grouped
from service.formats.foreign.table import ForeignTableError
from service.frontend.upload.plan_binding import BatchAction, BatchReply, judge, read_receipt
from service.records.csv_guard import guarded
from service.records.epoch import format_epoch

_FORMAT = 2
#: rows of a file that are settled, with any outcome, and what became of them, over all runs
_COUNTERS = ("rows", "accepted", "duplicates", "late", "refused")
_READINGS_OF_A_BATCH = 5000
#: rows whose cells mean nothing
_UNREADABLE = "row.unreadable"


class SendInterruptedError(ClientError):
    """The service did not take the rest; the same command continues where it stopped."""


@dataclass(frozen=True, slots=True)
class SendOrder:
    """Order to send the rows of a file."""

    path: Path
    spacecraft_id: str
    source: str
    #: what is stated of the file: under another statement it is sent again from its beginning
    statement: str = ""
    batch_rows: int = 1000
    #: longest wait for a service that does not answer, s
    patience_s: float = 600.0
    #: where state and refused rows are kept; None: beside the file
    folder: Path | None = None


class SendState:
    """State of one sending, in a small file beside its table, and the file of refused rows.

    Parameters
    ----------
    order : SendOrder
        File and destination.
    service : str
        URL of the service.
    """

    def __init__(self, order: SendOrder, service: str) -> None:
        with order.path.open("rb") as file:
            self.sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        self._destination = {
            "sha256": self.sha256,
            "service": service,
            "spacecraft_id": order.spacecraft_id,
            "source": order.source,
            "statement": order.statement,
        }
        key = hashlib.sha256(json.dumps(self._destination, sort_keys=True).encode()).hexdigest()[:16]
        position = order.folder or order.path.parent
        self.path = position / f"{order.path.name}.{key}.send.json"
        self.refused_path = position / f"{order.path.name}.refused.csv"
        self.counters = dict.fromkeys(_COUNTERS, 0)
        self.is_complete = False
        #: under which the rows go; None before the first
        self.plan_id: int | None = None
        self._refused_bytes = 0
        self._load()

    def _load(self) -> None:
        """Read what an earlier run left."""
        try:
            said: dict[str, Any] = json.loads(self.path.read_text())
        except FileNotFoundError:
            return
        except (OSError, ValueError) as error:
            raise ForeignTableError(f"{self.path} cannot be read: {error}; remove it to begin again") from error
        if said.get("format") != _FORMAT or said.get("destination") != self._destination:
            raise ForeignTableError(f"{self.path} belongs to another upload; remove it to begin again")
        self.counters |= said["counters"]
        self.is_complete, self.plan_id = bool(said["is_complete"]), said.get("plan_id")
        self._refused_bytes = int(said["refused_bytes"])

    def begin(self) -> None:
        """Make the places ready; what was refused beyond the state's knowledge is cut off."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.refused_path.exists():
            if self._refused_bytes:
                os.truncate(self.refused_path, self._refused_bytes)
            else:
                self.refused_path.unlink()

    def refuse(self, names: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
        """Write rows (line, code, reason, epoch, levels) to the file of refused rows."""
        if not rows:
            return
        text = io.StringIO()
        writer = csv.writer(text)
        if not self._refused_bytes:
            writer.writerow(("line", "code", "detail", "epoch", *(guarded(f"{name}_dbm") for name in names)))
        writer.writerows([guarded(cell) if isinstance(cell, str) else cell for cell in row] for row in rows)
        with self.refused_path.open("ab") as file:
            file.write(text.getvalue().encode())
            file.flush()
            os.fsync(file.fileno())
            self._refused_bytes = file.tell()

    def save(self) -> None:
        """Write the state through to the disk, in place of the one before."""
        document = {
            "format": _FORMAT,
            "destination": self._destination,
            "counters": self.counters,
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


@dataclass(slots=True)
class _Sender:
    """Sends the rows of one file."""

    client: ServiceClient
    order: SendOrder
    state: SendState
    rows: TableRows
    backoff: Backoff
    batch_rows: int
    #: line and reason of the rows of this run that the service refused
    refusals: list[tuple[int, str]] = field(default_factory=list)

    def send(self, on_progress: Callable[[int], None]) -> None:
        """Send what is left, and say how many rows are settled."""
        state, total = self.state, len(self.rows.lines)
        if state.counters["rows"] == 0 and self.rows.faults:
            absent = [""] * (1 + len(self.rows.names))
            state.refuse(self.rows.names, [(line, _UNREADABLE, why, *absent) for line, why in self.rows.faults])
        while state.counters["rows"] < total:
            start = state.counters["rows"]
            self._settle(start, min(start + self.order.batch_rows, total))
            state.is_complete = state.counters["rows"] == total
            state.save()
            on_progress(state.counters["rows"])
        state.is_complete = True
        state.save()

    def _settle(self, start: int, stop: int) -> None:
        """Deliver some rows and count what became of them."""
        counters, refused = self.state.counters, []
        position = start
        while position < stop:
            part = self._documents(position, min(position + self.batch_rows, stop))
            sent, receipt = self._deliver(part)
            for name in ("accepted", "duplicates", "late"):
                counters[name] += getattr(receipt, name)
            counters["refused"] += len(receipt.refused)
            for k, (code, detail) in sorted(receipt.refused.items()):
                line = int(self.rows.lines[position + k])
                self.refusals.append((line, f"{code}: {detail}"))
                refused.append((line, code, detail, part[k]["epoch"], *part[k]["power_dbm"]))
            position += sent
        self.state.refuse(self.rows.names, refused)
        counters["rows"] = stop

    def _documents(self, start: int, stop: int) -> list[dict[str, Any]]:
        """Return rows as the contract has them."""
        texts = np.datetime_as_string(self.rows.epochs_us[start:stop].astype("datetime64[us]")).tolist()
        levels = _with_absent(self.rows.values[start:stop])
        return [{"epoch": f"{text}Z", "power_dbm": row} for text, row in zip(texts, levels, strict=True)]

    def _deliver(self, rows: list[dict[str, Any]]) -> tuple[int, BatchReply]:
        """Send rows, or the first of them, until that is answered; return how many are settled, and how."""
        deadline_s = time.monotonic() + self.order.patience_s
        while True:
            try:
                receipt = self._post(rows)
            except ServiceUnavailableError as error:
                wait_s = max(self.backoff.next_s(), error.retry_after_s or 0.0)
                if time.monotonic() + wait_s > deadline_s:
                    raise SendInterruptedError(f"{error}; run the same command again to continue") from error
                time.sleep(wait_s)
            except ProblemError as problem:
                rows = self._shortened(problem, rows)
                if not rows:
                    return 1, BatchReply(0, 0, 0, {0: (problem.code, problem.detail)})
            else:
                self.backoff.reset()
                return len(rows), receipt

    def _shortened(self, problem: ProblemError, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """Return the rows to be sent after a batch was refused as a whole; none when its first row is the reason."""
        verdict, position = judge(problem, len(rows))
        if verdict is BatchAction.SHORTER:
            self.batch_rows = max(1, len(rows) // 2)
            return rows[: self.batch_rows]
        if verdict is BatchAction.PARTED:
            return rows[:position]
        raise problem

    def _post(self, rows: list[dict[str, Any]]) -> BatchReply:
        """Send rows once; they take no sequence numbers, which belong to the front end."""
        plan_id = int(self.state.plan_id or 0)
        reply = self.client.post_measurements(self.order.spacecraft_id, plan_id, rows, source=self.order.source)
        receipt = read_receipt(reply, len(rows))
        if receipt is None:
            raise ServiceUnavailableError(f"the answer does not account for {len(rows)} rows: {str(reply)[:200]}")
        return receipt


def send_powers(
    client: ServiceClient,
    order: SendOrder,
    rows: TableRows,
    state: SendState,
    backoff: Backoff | None = None,
    *,
    is_quiet: bool = True,
) -> dict[str, Any]:
    """Send the powers of a file, or the rest of them, and return what became of its rows over all runs.

    On a terminal a bar shows the progress.

    Raises
    ------
    SendInterruptedError
        The service did not answer for longer than the order's patience; the next call goes on.
    ProblemError
        The service refuses the whole request, for example the key or the spacecraft.
    """
    begun_s = time.monotonic()
    resumed_at = state.counters["rows"]
    sender = _Sender(client, order, state, rows, backoff or Backoff(), order.batch_rows)
    if not state.is_complete:
        if state.plan_id is None:
            state.plan_id = int(client.carriers(order.spacecraft_id)["plan_id"])
        state.begin()
        state.save()
        with _progress(is_quiet=is_quiet) as bar:
            task = bar.add_task(order.path.name, total=len(rows.lines), completed=resumed_at)
            sender.send(lambda settled: bar.update(task, completed=settled))
    kept_back = state.counters["refused"] + len(rows.faults)
    return {
        "file": str(order.path),
        "sha256": state.sha256,
        **state.counters,
        "unreadable": len(rows.faults),
        "other_sources": rows.other_sources,
        "resumed_at": resumed_at,
        "faults": grouped([*rows.faults, *sender.refusals]),
        "refused_file": str(state.refused_path) if kept_back else None,
        "state_file": str(state.path),
        "seconds": round(time.monotonic() - begun_s, 3),
    }


def _progress(*, is_quiet: bool) -> Any:
    """Return a progress bar; away from a terminal it would be noise."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    return Progress(console=console, disable=is_quiet or not console.is_terminal)


def send_readings(client: ServiceClient, spacecraft: str, stated: ReadingsStatement, rows: TableRows) -> dict[str, Any]:
    """Send all readings and return what became of them; repeating them is safe."""
    counts = {"accepted": 0, "duplicates": 0, "refused": 0}
    documents = _reading_documents(rows, {str(axis): value for axis, value in stated.sigma_deg.items()})
    for start in range(0, len(documents), _READINGS_OF_A_BATCH):
        reply = client.post_references(spacecraft, stated.source, documents[start : start + _READINGS_OF_A_BATCH])
        for name, count in counts.items():
            counts[name] = count + (len(reply[name]) if name == "refused" else reply[name])
    return {**counts, "unreadable": len(rows.faults), "faults": grouped(rows.faults)}


def _with_absent(values: FloatArray) -> list[list[float | None]]:
    """Return rows of numbers, None in place of NaN."""
    found = values.astype(object)
    found[np.isnan(values)] = None
    rows: list[list[float | None]] = found.tolist()
    return rows


def _reading_documents(rows: TableRows, sigma_deg: dict[str, float]) -> list[dict[str, Any]]:
    """Return readings as the interface has them; those without any angle are none."""
    stated: list[dict[str, Any]] = [{"sigma_deg": sigma_deg}] * len(rows.lines) if sigma_deg else [{}] * len(rows.lines)
    if rows.sigma_deg is not None and not sigma_deg:
        named = [dict(zip(AXES, row, strict=True)) for row in _with_absent(rows.sigma_deg)]
        stated = [{"sigma_deg": each} if any(each.values()) else {} for each in named]
    texts = np.datetime_as_string(rows.epochs_us.astype("datetime64[us]")).tolist()
    found = []
    for text, values, more in zip(texts, _with_absent(rows.values), stated, strict=True):
        if any(value is not None for value in values):
            angles = {f"{axis}_deg": value for axis, value in zip(AXES, values, strict=True)}
            found.append({"epoch": f"{text}Z", **angles, **more})
    return found


_POLL_S = 0.5


def wait_for_angles(client: ServiceClient, spacecraft_id: str, patience_s: float, *, is_quiet: bool) -> dict[str, Any]:
    """Return the state of the estimates when no row is pending, or when none was estimated for ``patience_s``."""
    with _progress(is_quiet=is_quiet) as bar:
        task = bar.add_task("angles", total=None)
        least, deadline_s = None, time.monotonic() + patience_s
        while True:
            try:
                status: dict[str, Any] = dict(client.status(spacecraft_id))
            except ServiceUnavailableError:
                # the first row of an installation may wait for the compiler, and the answer with it
                if time.monotonic() > deadline_s:
                    raise
            else:
                pending = status["pending"]
                bar.update(task, description=f"angles: {pending} rows pending")
                if least is None or pending < least:
                    least, deadline_s = pending, time.monotonic() + patience_s
                if not pending or time.monotonic() > deadline_s:
                    names = ("aligned", "pending", "newest_attitude", "calibration_id", "alignment_id")
                    return {name: status[name] for name in names}
            time.sleep(_POLL_S)


def angles_line(angles: dict[str, Any], spacecraft_id: str) -> str:
    """Return the state of the estimates as a sentence, with the next command."""
    if not angles["aligned"]:
        step = "align" if angles["calibration_id"] is not None else "calibrate"
        return f"no angles yet: the spacecraft is not aligned; next: soo {step} --spacecraft {spacecraft_id} --help"
    if angles["pending"]:
        return f"{angles['pending']} rows still have no angles; the service computes on: soo doctor tells why not"
    return f"angles exist up to {angles['newest_attitude']}"


def span_lines(rows: TableRows, unit: str) -> list[tuple[str, str]]:
    """Return span, gaps and values of each column for people."""
    steps_us = np.diff(rows.epochs_us)
    usual_us = float(np.median(steps_us[steps_us > 0])) if (steps_us > 0).any() else 0.0
    gaps = np.flatnonzero(steps_us > 2.5 * usual_us) if usual_us else np.empty(0, dtype=np.int64)
    found = [("usual step, s", f"{usual_us / 1e6:g}"), ("duplicate epochs", str(int(np.sum(steps_us == 0))))]
    longest = gaps[np.argsort(-steps_us[gaps], kind="stable")][:10]
    for k in longest.tolist():
        start, stop = (format_epoch(int(rows.epochs_us[each])) for each in (k, k + 1))
        found.append(("gap", f"{start} to {stop}, {steps_us[k] / 1e6:.0f} s"))
    for name, column in zip(rows.names, rows.values.T, strict=True):
        held = column[np.isfinite(column)]
        span = f"{held.min():g} to {held.max():g} {unit}, mean {held.mean():.4g}" if len(held) else "absent"
        found.append((name, f"{span}, {len(column) - len(held)} empty"))
    return found
