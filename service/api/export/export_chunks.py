"""Stretches of a series as they are read for a file: blocks of arrays or pages of records, in order of epoch."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Protocol, TypeVar

import numpy as np

from service.records.levels.attitude import IntArray
from service.records.levels.measurement_block import MeasurementBlock

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


def pages_of(read: Callable[[tuple[int, int] | None], Sequence[D]], number_of: Callable[[D], int]) -> Iterator[Chunk]:
    """Yield records page by page until one is short.

    Parameters
    ----------
    read : callable
        Gives at most ``PAGE_ROWS`` records beyond a place (epoch, number).
    number_of : callable
        Gives the number of a record.
    """
    after: tuple[int, int] | None = None
    while True:
        records = read(after)
        if records:
            yield record_page(records)
        if len(records) < PAGE_ROWS:
            return
        after = (records[-1].epoch_us, number_of(records[-1]))


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
