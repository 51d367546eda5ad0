"""Measurements of the archive with what one method made of each, page by page; memory is that of one page."""

from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from itertools import islice
from operator import attrgetter
from typing import NamedTuple, TypeVar, cast

from service.api.export.export_chunks import PAGE_ROWS, Chunk, RecordPage, pages_of, record_page
from service.formats.tabular.joined_table import JoinedRow
from service.ports import Storage
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.levels.attitude import AttitudeRow
from service.records.levels.command import TorqueCommand
from service.records.levels.measurement import Measurement

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
    read = partial(source.storage.archive.measurements, source.spacecraft_id, window, PAGE_ROWS)
    rows = (row for row in _all(read) if row.plan_id in source.plan_ids)
    size = min(PAGE_ROWS, PAGE_POWERS // max(carriers, 1) + 1)
    while page := list(islice(rows, size)):
        yield record_page(_joined(source, page))


def _joined(source: JoinedSource, page: Sequence[Measurement]) -> list[JoinedRow]:
    """Return the rows of a page with what is stored for each."""
    results, of = source.storage.results, (source.spacecraft_id, source.version)
    window = Window(page[0].epoch_us, page[-1].epoch_us + 1)
    carriers = results.carrier_results(*of, source.method, window)
    rows = _all(partial(results.attitude_rows, *of, source.method, window, PAGE_ROWS))
    attitude = {(row.epoch_us, row.number): row for row in rows}
    numbers = {row.number for row in page}
    commands = {
        command.number: command
        for span in _command_spans(page)
        for command in _all(partial(results.commands, *of, span, PAGE_ROWS))
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


def _all(read: Callable[[tuple[int, int] | None], Sequence[N]]) -> Iterator[N]:
    """Yield every record that a reader of pages gives."""
    pages = cast("Iterator[RecordPage]", pages_of(read, attrgetter("number")))
    return (record for page in pages for record in cast("Sequence[N]", page.records))
