"""Stretches of a series as they are read for a file: blocks, pages, rows of two series joined, read ahead."""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, groupby, islice, pairwise
from operator import attrgetter
from threading import Condition, Thread
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from service.formats.series_tables import JoinedRow
from service.ports.archive import ListPart
from service.ports.storage import Storage
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.levels.attitude import AttitudeRow, IntArray, TorqueCommand
from service.records.levels.measurement import Measurement, MeasurementBlock

DAY_US = 86_400_000_000
#: rows of a page of records
PAGE_ROWS = 2000


class Dated(Protocol):
    """A record that stands at one epoch."""

    @property
    def epoch_us(self) -> int:
        """Microseconds UTC."""


@dataclass(frozen=True, slots=True)
class RecordPage:
    """Records in order of epoch."""

    #: (T,) microseconds UTC
    epochs_us: IntArray
    records: Sequence[Dated]


Chunk = MeasurementBlock | RecordPage
D = TypeVar("D", bound=Dated)
R = TypeVar("R")
#: place of a record in a list
_by_epoch: Callable[[Any], tuple[int, int]] = attrgetter("epoch_us", "number")


def pages(
    read: Callable[[ListPart], Sequence[R]], window: Window, position: Callable[[R], tuple[int, int]] = _by_epoch
) -> Iterator[Sequence[R]]:
    """Yield the records of a window page by page until one is short.

    Parameters
    ----------
    read : callable
        Gives the records of a part of the list.
    window : Window
        Where they are.
    position : callable
        Gives the place of a record.
    """
    after: tuple[int, int] | None = None
    while True:
        page = read(ListPart(window, PAGE_ROWS, after))
        if page:
            yield page
        if len(page) < PAGE_ROWS:
            return
        after = position(page[-1])


def pages_of(read: Callable[[ListPart], Sequence[D]], window: Window) -> Iterator[Chunk]:
    """Return the records of a window page by page."""
    return map(record_page, pages(read, window))


def record_page(records: Sequence[Dated]) -> RecordPage:
    """Return records with their epochs beside them."""
    return RecordPage(np.array([record.epoch_us for record in records], dtype=np.int64), records)


def by_day(chunks: Iterable[Chunk]) -> Iterator[tuple[int, Iterator[Chunk]]]:
    """Yield each UTC day that holds rows (its first microsecond) with its rows; a day is read before the next begins.

    Parameters
    ----------
    chunks : iterable
        In order of epoch.
    """
    parts = (part for chunk in chunks for part in _cut_by_day(chunk))
    return groupby(parts, key=lambda part: int(part.epochs_us[0]) // DAY_US * DAY_US)


def _cut_by_day(chunk: Chunk) -> Iterator[Chunk]:
    """Yield the parts of a chunk that lie within one day each."""
    days = chunk.epochs_us // DAY_US
    bounds = [0, *(np.flatnonzero(np.diff(days)) + 1).tolist(), len(days)]
    for first, last in pairwise(bounds):
        if last - first == len(days):
            yield chunk
        elif isinstance(chunk, MeasurementBlock):
            yield chunk.part(first, last)
        else:
            yield RecordPage(chunk.epochs_us[first:last], chunk.records[first:last])


N = TypeVar("N", Measurement, AttitudeRow, TorqueCommand)
#: powers of the rows that are joined at once
PAGE_POWERS = 16 * PAGE_ROWS


class JoinedSource(NamedTuple):
    """Archive, plans, method and version of joined rows."""

    storage: Storage
    spacecraft_id: str
    #: rows of other plans are left out
    plan_ids: Collection[int]
    method: Method
    version: str


def joined_rows(source: JoinedSource, window: Window, carriers: int) -> Iterator[Chunk]:
    """Yield the measurements of a window with their results, in order of (epoch, number).

    Parameters
    ----------
    source : JoinedSource
        Archive, plans, method and version.
    window : Window
        Epochs of the measurements.
    carriers : int
        Columns of powers; more of them make shorter pages.
    """
    read = partial(source.storage.archive.measurements, source.spacecraft_id)
    rows = (row for row in _all(read, window) if row.plan_id in source.plan_ids)
    size = min(PAGE_ROWS, PAGE_POWERS // max(carriers, 1) + 1)
    while page := list(islice(rows, size)):
        yield record_page(_joined(source, page))


def _joined(source: JoinedSource, page: Sequence[Measurement]) -> list[JoinedRow]:
    results, of = source.storage.results, (source.spacecraft_id, source.version)
    window = Window(page[0].epoch_us, page[-1].epoch_us + 1)
    carriers = results.carrier_results(*of, source.method, window)
    rows = _all(partial(results.attitude_rows, *of, source.method), window)
    attitude = {(row.epoch_us, row.number): row for row in rows}
    numbers = {row.number for row in page}
    commands = {
        command.number: command
        for span in _command_spans(page)
        for command in _all(partial(results.commands, *of), span)
        if command.number in numbers
    }
    keys = ((row.epoch_us, row.number) for row in page)
    return [
        JoinedRow(row, attitude.get(key), carriers.get(key), commands.get(row.number))
        for row, key in zip(page, keys, strict=True)
    ]


def _command_spans(page: Sequence[Measurement]) -> list[Window]:
    """Return where the commands of a page begin: at the epochs of its rows, or when those were received if later.

    Rows that were received long after their epochs make two spans, with nothing of what lies between them.
    """
    starts = [max(row.epoch_us, row.received_at_us) for row in page]
    measured, received = Window(page[0].epoch_us, page[-1].epoch_us + 1), Window(min(starts), max(starts) + 1)
    if received.start_us <= measured.stop_us:
        return [Window(measured.start_us, received.stop_us)]
    return [measured, received]


def _all(read: Callable[[ListPart], Sequence[N]], window: Window) -> Iterator[N]:
    """Return every record that a reader of pages gives."""
    return chain.from_iterable(pages(read, window))


#: powers that wait to be written; a group of rows of Parquet is written in one go and takes as much meanwhile
AHEAD_BYTES = 4 << 20


def read_ahead(blocks: Iterator[MeasurementBlock]) -> Iterator[MeasurementBlock]:
    """Yield the same blocks, the next ones read meanwhile, as many as fit ``AHEAD_BYTES`` and one.

    Reading unpacks and writing formats without Python's lock, so both run at once.
    """
    line = _Line(blocks)
    line.start()
    try:
        while (block := line.next_block()) is not None:
            yield block
    finally:
        line.stop()


class _Line(Thread):
    """Blocks on their way from one thread to another."""

    def __init__(self, blocks: Iterator[MeasurementBlock]) -> None:
        super().__init__(name="read-ahead", daemon=True)
        self._blocks = blocks
        self._waiting: deque[MeasurementBlock] = deque()
        self._bytes = 0
        self._changed = Condition()
        self._is_done = False
        self._is_unwanted = False
        self._fault: BaseException | None = None

    def run(self) -> None:
        """Read until nobody wants more."""
        try:
            for block in self._blocks:
                if not self._add(block):
                    break
        except BaseException as fault:  # noqa: BLE001 raised to the reader of the blocks
            self._fault = fault
        with self._changed:
            self._is_done = True
            self._changed.notify_all()

    def next_block(self) -> MeasurementBlock | None:
        """Return the next block, None after the last; what reading raised is raised here."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._is_done)
            if not self._waiting:
                if self._fault is not None:
                    raise self._fault
                return None
            block = self._waiting.popleft()
            self._bytes -= block.power_dbm.nbytes
            self._changed.notify_all()
            return block

    def stop(self) -> None:
        """Let the thread end and wait for it: nothing of the archive is in use afterwards."""
        with self._changed:
            self._is_unwanted = True
            self._changed.notify_all()
        self.join()

    def _add(self, block: MeasurementBlock) -> bool:
        """Queue a block when there is room; False when nobody wants it."""
        with self._changed:
            self._changed.wait_for(lambda: self._bytes < AHEAD_BYTES or self._is_unwanted)
            self._waiting.append(block)
            self._bytes += block.power_dbm.nbytes
            self._changed.notify_all()
            return not self._is_unwanted
