"""Series of the archive as files: which formats a series has, how it is read, and how it is written.

Law of this file: bytes follow from the rows, the span and the parameters alone. Nothing of the moment of asking goes
into them, so that the same span of a past day is the same file for ever; see decision 0011.
"""

import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from heapq import merge
from itertools import chain, islice
from typing import Any, Literal, NamedTuple, cast

from service.api.context import ApiContext, check_method, check_version
from service.api.export import export_chunks
from service.errors import InvalidInputError, NotFoundError
from service.formats import series_tables
from service.formats.ccsds import AemWriter, AttitudeMessage
from service.formats.table_file import (
    MeasurementColumns,
    SeriesTable,
    TableFormat,
    measurement_bytes,
    table_bytes,
)
from service.formats.tdm import TdmWriter, TrackingMessage
from service.ports.archive import LIVE
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.inputs import KIND_OF, JournalEntry
from service.records.levels.measurement import Measurement, MeasurementBlock
from service.records.operations.alarms import Alarm

FileFormat = Literal["csv", "ndjson", "parquet", "aem", "tdm"]
MEDIA_TYPES: dict[FileFormat, str] = {
    "csv": "text/csv; charset=utf-8",
    "ndjson": "application/x-ndjson",
    "parquet": "application/vnd.apache.parquet",
    "aem": "text/plain; charset=us-ascii",
    "tdm": "text/plain; charset=us-ascii",
}
_TABLES: tuple[FileFormat, ...] = ("csv", "ndjson", "parquet")
#: formats of each series
OFFERED: dict[str, tuple[FileFormat, ...]] = {
    "measurements": (*_TABLES, "tdm"),
    "attitude": (*_TABLES, "aem"),
    "torques": _TABLES,
    "references": _TABLES,
    "telemetry": _TABLES,
    "polarization": _TABLES,
    "events": _TABLES,
    "joined": _TABLES,
}
#: parameters beside the span that a series has
_PARAMETERS = {
    "measurements": {"plan_id"},
    "attitude": {"method", "version"},
    "torques": {"version"},
    "joined": {"plan_id", "method", "version"},
}
#: slow inputs that are series of their own: kind in the journal, and columns
_OF_INPUTS: dict[str, tuple[str, SeriesTable[Any]]] = {
    "references": ("reference", series_tables.REFERENCES),
    "telemetry": ("telemetry", series_tables.TELEMETRY),
    "polarization": ("polarization", series_tables.POLARIZATION),
}
#: kinds of the journal that are events
EVENT_KINDS = (
    "operation",
    "correction",
    "spacecraft",
    "plan",
    "ephemeris",
    "activation",
    "alignment",
    "source",
)


class FileOrder(NamedTuple):
    """Order of one export file: spacecraft, series, format and window."""

    spacecraft_id: str
    series: str
    file_format: FileFormat
    window: Window
    method: Method | None = None
    version: str | None = None
    plan_ids: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class ArchiveFile:
    """A stretch of a series that can be read and written."""

    #: stem of a file's name
    label: str
    #: parameters that name the same file again, defaults filled in
    parameters: tuple[tuple[str, str], ...]
    #: rows of a part of the span
    read: Callable[[Window], Iterator[export_chunks.Chunk]]
    #: rows of a part of the span, and that part
    write: Callable[[Iterable[export_chunks.Chunk], Window], Iterator[bytes]]


def archive_file(context: ApiContext, names: Callable[[str, int], Sequence[str]], order: FileOrder) -> ArchiveFile:
    """Return the file that is asked for.

    Parameters
    ----------
    context : ApiContext
        Archive and clock.
    names : callable
        Gives the carrier ids of a plan of a spacecraft.
    order : FileOrder
        What is asked for.

    Raises
    ------
    SooError
        ``spacecraft.unknown``, ``export.series_unknown``, ``export.format``, ``export.parameter``, ``plan.unknown``,
        ``replay.unknown``.
    """
    context.storage.catalogue.spacecraft(order.spacecraft_id)
    _check_offered(order)
    return _MAKERS[order.series](_Maker(context, names, order))


def _check_offered(order: FileOrder) -> None:
    """Refuse what a series does not have."""
    formats = OFFERED.get(order.series)
    if formats is None:
        detail = f"no series {order.series[:64]!r}; there are {', '.join(OFFERED)}"
        raise NotFoundError("export.series_unknown", detail)
    if order.file_format not in formats:
        detail = f"the series {order.series} is written as {', '.join(formats)}"
        raise InvalidInputError("export.format", detail)
    given = {"method": order.method, "version": order.version, "plan_id": order.plan_ids or None}
    foreign = {name for name, value in given.items() if value is not None} - _PARAMETERS.get(order.series, set())
    if foreign:
        detail = f"the series {order.series} has no {' and no '.join(sorted(foreign))}"
        raise InvalidInputError("export.parameter", detail)


class _Maker:
    """Makes files of one order; see `archive_file`."""

    def __init__(self, context: ApiContext, names: Callable[[str, int], Sequence[str]], order: FileOrder) -> None:
        self._context = context
        self._names = names
        self._order = order
        self._format = order.file_format
        self._sc, self._window = order.spacecraft_id, order.window

    def measurements(self) -> ArchiveFile:
        """Return the file of measurements; its columns are the carriers of the plans named and of those that occur."""
        archive = self._context.storage.archive
        columns, parameters, plan_ids = self._columns()
        if self._format == "tdm":
            rows = self._measurement_rows
            return ArchiveFile("measurements", (), rows, self._tdm)

        def read(window: Window) -> Iterator[export_chunks.Chunk]:
            # a plan that came up after the columns were fixed is of rows that came after the asking
            blocks = archive.measurement_blocks(self._sc, window)
            return export_chunks.read_ahead(block for block in blocks if block.plan_id in plan_ids)

        def write(chunks: Iterable[export_chunks.Chunk], _: Window) -> Iterator[bytes]:
            blocks = cast("Iterable[MeasurementBlock]", chunks)
            return measurement_bytes(columns, cast("TableFormat", self._format), blocks)

        return ArchiveFile("measurements", parameters, read, write)

    def attitude(self) -> ArchiveFile:
        """Return the file of attitude rows of one method and version."""
        spacecraft = self._context.storage.catalogue.spacecraft(self._sc)
        results, (method, version) = self._context.storage.results, self._estimates()
        parameters = (("method", method.value), ("version", version))

        def read(window: Window) -> Iterator[export_chunks.Chunk]:
            return export_chunks.pages_of(partial(results.attitude_rows, self._sc, version, method), window)

        def write_aem(chunks: Iterable[export_chunks.Chunk], part: Window) -> Iterator[bytes]:
            name, object_id = spacecraft.name, spacecraft.cospar_id or spacecraft.id
            writer = AemWriter(
                AttitudeMessage(
                    name,
                    object_id,
                    self._message_id(f"{method.value}/{version}", part),
                    self._created_us(part),
                    f"{method.value} {version}",
                )
            )
            yield writer.header()
            yield from writer.segments(_records(chunks))

        write = write_aem if self._format == "aem" else self._table(series_tables.ATTITUDE)
        return ArchiveFile(f"attitude_{method.value}_{version}", parameters, read, write)

    def torques(self) -> ArchiveFile:
        """Return the file of computed commands."""
        results, version = self._context.storage.results, self._version()

        def read(window: Window) -> Iterator[export_chunks.Chunk]:
            return export_chunks.pages_of(partial(results.commands, self._sc, version), window)

        return ArchiveFile(f"torques_{version}", (("version", version),), read, self._table(series_tables.TORQUES))

    def joined(self) -> ArchiveFile:
        """Return the file of measurements with what one method made of each."""
        columns, plans, plan_ids = self._columns()
        method, version = self._estimates()
        source = export_chunks.JoinedSource(self._context.storage, self._sc, plan_ids, method, version)
        parameters = (*plans, ("method", method.value), ("version", version))

        def read(window: Window) -> Iterator[export_chunks.Chunk]:
            return export_chunks.joined_rows(source, window, len(columns.carriers))

        label = f"joined_{method.value}_{version}"
        return ArchiveFile(label, parameters, read, self._table(series_tables.joined_table(columns)))

    def inputs(self) -> ArchiveFile:
        """Return the file of a kind of slow inputs."""
        kind, table = _OF_INPUTS[self._order.series]

        def read(window: Window) -> Iterator[export_chunks.Chunk]:
            return _paged(entry.content for entry in self._entries(kind, window))

        return ArchiveFile(self._order.series, (), read, self._table(table))

    def events(self) -> ArchiveFile:
        """Return the file of events that begin in the span, in order of their beginning."""

        def read(window: Window) -> Iterator[export_chunks.Chunk]:
            kinds = [map(_event, self._entries(kind, window)) for kind in EVENT_KINDS]
            rows = merge(*kinds, self._alarms(window), key=lambda row: (row.epoch_us, row.number))
            return _paged(row for row in rows if row.epoch_us >= window.start_us)

        return ArchiveFile("events", (), read, self._table(series_tables.EVENTS))

    def _entries(self, kind: str, window: Window) -> Iterator[JournalEntry]:
        """Return the slow inputs of a kind in order of (start, number)."""
        read = partial(self._context.storage.archive.inputs, self._sc, kind)
        return chain.from_iterable(export_chunks.pages(read, window, lambda entry: (entry.start_us or 0, entry.number)))

    def _alarms(self, window: Window) -> Iterator[series_tables.EventRow]:
        """Return the alarms that were raised, in order of (raised, id)."""
        read = partial(self._context.storage.alarms.alarms, self._sc, ())
        alarms = export_chunks.pages(read, window, lambda alarm: (alarm.raised_at_us, alarm.id))
        return map(_alarm_event, chain.from_iterable(alarms))

    def _measurement_rows(self, window: Window) -> Iterator[export_chunks.Chunk]:
        archive = self._context.storage.archive
        return export_chunks.pages_of(partial(archive.measurements, self._sc), window)

    def _tdm(self, chunks: Iterable[export_chunks.Chunk], part: Window) -> Iterator[bytes]:
        catalogue = self._context.storage.catalogue
        spacecraft = catalogue.spacecraft(self._sc)
        message = TrackingMessage(
            spacecraft.name,
            spacecraft.receiving_site.name or "GROUND STATION",
            self._message_id("powers", part),
            self._created_us(part),
        )
        writer = TdmWriter(message, lambda plan_id: catalogue.plan(self._sc, plan_id).carriers)
        yield writer.header()
        yield from writer.segments(cast("Iterable[Sequence[Measurement]]", _records(chunks)))

    def _table(self, table: SeriesTable[Any]) -> Callable[[Iterable[export_chunks.Chunk], Window], Iterator[bytes]]:
        file_format = cast("TableFormat", self._format)
        return lambda chunks, _: table_bytes(table, file_format, _records(chunks))

    def _columns(self) -> tuple[MeasurementColumns, tuple[tuple[str, str], ...], tuple[int, ...]]:
        """Return the columns of powers of the plans named and of those that occur, and those plans."""
        found = self._context.storage.archive.plan_ids(self._sc, self._window)
        plan_ids = tuple(dict.fromkeys((*self._order.plan_ids, *found)))
        plans = [self._names(self._sc, plan_id) for plan_id in plan_ids]
        columns = MeasurementColumns(plans, lambda plan_id: self._names(self._sc, plan_id))
        return columns, tuple(("plan_id", str(plan_id)) for plan_id in plan_ids), plan_ids

    def _estimates(self) -> tuple[Method, str]:
        """Return method and version of the rows that are asked for."""
        version = self._version()
        method = self._order.method or self._context.storage.catalogue.spacecraft(self._sc).control.method
        check_method(method, version)
        return method, version

    def _version(self) -> str:
        version = self._order.version or LIVE
        check_version(self._context.storage.results, self._sc, version)
        return version

    def _message_id(self, what: str, part: Window) -> str:
        """Return the id of a message: the same message has the same."""
        name = f"urn:soo:{self._sc}/{what}/{part.start_us}/{part.stop_us}"
        return str(uuid.uuid5(uuid.NAMESPACE_URL, name))

    def _created_us(self, part: Window) -> int:
        """Return when a message was complete: the end of its span, or now while that lies ahead."""
        return min(part.stop_us, self._context.clock.system_us())


_MAKERS: dict[str, Callable[[_Maker], ArchiveFile]] = {
    "measurements": _Maker.measurements,
    "attitude": _Maker.attitude,
    "torques": _Maker.torques,
    **dict.fromkeys(_OF_INPUTS, _Maker.inputs),
    "events": _Maker.events,
    "joined": _Maker.joined,
}


def _records(chunks: Iterable[export_chunks.Chunk]) -> Iterator[Any]:
    return (chunk.records for chunk in chunks if isinstance(chunk, export_chunks.RecordPage))


def _paged(records: Iterable[Any]) -> Iterator[export_chunks.Chunk]:
    rest = iter(records)
    while page := list(islice(rest, export_chunks.PAGE_ROWS)):
        yield export_chunks.record_page(page)


def _event(entry: JournalEntry) -> series_tables.EventRow:
    content: Any = entry.content
    start_us = entry.start_us or 0
    stop_us = None if entry.stop_us == start_us else entry.stop_us
    return series_tables.EventRow(
        start_us, stop_us, entry.number, KIND_OF[type(content)], content.key, series_tables.plain_value(content)
    )


def _alarm_event(alarm: Alarm) -> series_tables.EventRow:
    """Return the event that an alarm is, as it stands now."""
    document = {**series_tables.plain_value(alarm), "severity": alarm.severity.word}
    key = f"{alarm.condition}/{alarm.thing}"
    return series_tables.EventRow(alarm.raised_at_us, alarm.returned_at_us, alarm.id, "alarm", key, document)
