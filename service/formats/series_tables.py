"""Columns of the series that are kept as records: attitude, torques, slow inputs, events.

Columns of the joined series: one measurement with what one method made of it.

Columns: epoch, source, ``<carrier id>_dbm``; of each carrier ``_state``, ``_deviation_db`` and ``_residual_db``; those
of the attitude row; those of the torque command, each with ``command_`` before its name.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from itertools import chain
from operator import attrgetter
from typing import Any

import numpy as np

from service.formats.numbers import shortest_float32
from service.formats.table_file import Column, Kind, MeasurementColumns, SeriesTable
from service.records.epoch import format_epoch
from service.records.inputs import AttitudeReference, PolarizationRecord, TelemetryRecord
from service.records.levels.attitude import (
    CARRIER_STATES,
    AttitudeRow,
    Axes,
    CarrierResults,
    Pulse,
    ScheduleVerdict,
    TorqueCommand,
)
from service.records.levels.measurement import Measurement
from service.records.record_fields import FieldKind, RecordField, record_fields

_OF_CARRIER: dict[str, Kind] = {"state": "text", "deviation_db": "figure", "residual_db": "figure"}


@dataclass(frozen=True, slots=True)
class JoinedRow:
    """One measurement and what one method made of it; None = nothing."""

    measurement: Measurement
    attitude: AttitudeRow | None
    carriers: CarrierResults | None
    command: TorqueCommand | None

    @property
    def epoch_us(self) -> int:
        """Epoch of the measurement."""
        return self.measurement.epoch_us


def joined_table(columns: MeasurementColumns) -> SeriesTable[JoinedRow]:
    """Return the table of joined rows.

    Parameters
    ----------
    columns : MeasurementColumns
        Carriers of the plans that occur.
    """
    names = [
        Column("epoch", "epoch"),
        Column("source", "text"),
        *(Column(f"{carrier}_dbm", "level") for carrier in columns.carriers),
        *(Column(f"{carrier}_{name}", kind) for carrier in columns.carriers for name, kind in _OF_CARRIER.items()),
        *JOINED_ATTITUDE.columns,
        *(Column(f"command_{column.name}", column.kind) for column in TORQUES.columns),
    ]

    def values(row: JoinedRow) -> Sequence[Any]:
        measurement = row.measurement
        levels = _placed(columns, measurement.plan_id, shortest_float32(measurement.power_dbm), None)
        return [
            measurement.epoch_us,
            measurement.source,
            *levels,
            *chain.from_iterable(_of_carriers(columns, row.carriers)),
            *_part(JOINED_ATTITUDE, row.attitude),
            *_part(TORQUES, row.command),
        ]

    return SeriesTable(tuple(names), values)


def _of_carriers(columns: MeasurementColumns, results: CarrierResults | None) -> Sequence[Sequence[Any]]:
    """Return state, deviation and residual of each carrier, as the interface answers them."""
    nothing = (None,) * len(_OF_CARRIER)
    if results is None:
        return [nothing] * len(columns.carriers)
    states = [CARRIER_STATES[state] for state in results.state.tolist()]
    decibels = np.round((results.deviation_db, results.residual_db), 3).tolist()
    return _placed(columns, results.plan_id, list(zip(states, *decibels, strict=True)), nothing)


def _placed(columns: MeasurementColumns, plan_id: int, values: Sequence[Any], nothing: Any) -> Sequence[Any]:
    positions = columns.positions_of(plan_id)
    if positions is None:
        return values
    placed = [nothing] * len(columns.carriers)
    for position, value in zip(positions.tolist(), values, strict=True):
        placed[position] = value
    return placed


def _part(table: SeriesTable[Any], record: AttitudeRow | TorqueCommand | None) -> Sequence[Any]:
    """Return the cells of a record, empty ones without it."""
    return (None,) * len(table.columns) if record is None else table.values(record)


@dataclass(frozen=True, slots=True)
class EventRow:
    """Something that happened, or was declared to happen, in the life of a spacecraft."""

    epoch_us: int
    #: None = an instant, or still open
    stop_us: int | None
    #: journal number, or id of an alarm
    number: int
    #: kind in the journal (operation, correction, activation ..), or alarm
    kind: str
    #: its key within the kind
    key: str
    #: the record itself, as JSON can hold it
    document: Mapping[str, Any]


#: values of the columns of one field
Code = Callable[[Any], Sequence[Any]]
#: order of axes in the table of torques
_BODY = ("roll", "pitch", "yaw")
_KINDS: dict[FieldKind, Kind] = {
    FieldKind.EPOCH: "epoch",
    FieldKind.COUNT: "count",
    FieldKind.NUMBER: "figure",
    FieldKind.TRUTH: "truth",
    FieldKind.AXES: "figure",
    FieldKind.AXIS_TRUTHS: "truth",
    FieldKind.RECORDS: "document",
    FieldKind.DOCUMENT: "document",
}


def _pulse(pulse: Pulse) -> dict[str, Any]:
    torque = {f"{axis}_n_m": getattr(pulse.torque_n_m, axis) for axis in _BODY}
    return {"start": format_epoch(pulse.start_us), "duration_s": pulse.duration_s, **torque}


def _check(check: ScheduleVerdict | None) -> Sequence[Any]:
    return (None, None, None) if check is None else (check.verdict, check.peak_deg, check.margin)


#: fields whose columns do not follow from their types
_EXCEPTIONS: dict[str, tuple[dict[str, Kind], Code]] = {
    "excluded": ({"excluded": "text"}, lambda excluded: (";".join(f"{one.carrier}:{one.reason}" for one in excluded),)),
    "schedule": ({"schedule": "document"}, lambda pulses: ([_pulse(pulse) for pulse in pulses],)),
    "schedule_check": (
        {"schedule_verdict": "text", "schedule_peak_deg": "figure", "schedule_margin": "figure"},
        _check,
    ),
}
#: values of the columns of a field that are not the value itself
_CODES: dict[FieldKind, Code] = {
    FieldKind.TEXTS: lambda texts: (";".join(texts),),
    FieldKind.RECORDS: lambda records: (plain_value(records),),
}


def _columns(field: RecordField, axes: tuple[str, ...]) -> tuple[dict[str, Kind], Code | None, Sequence[str]]:
    """Return the columns of a field, what makes their values, and the paths to what it makes them from."""
    if field.name in _EXCEPTIONS:
        return *_EXCEPTIONS[field.name], (field.name,)
    kind, code = _KINDS.get(field.kind, "text"), _CODES.get(field.kind)
    if field.kind in {FieldKind.AXES, FieldKind.AXIS_TRUTHS}:
        if field.kind is FieldKind.AXIS_TRUTHS:
            places = [Axes._fields.index(axis) for axis in axes]
            code = lambda truths: [truths[place] for place in places]  # noqa: E731
        elif field.is_optional:
            code = lambda value: [None if value is None else getattr(value, axis) for axis in axes]  # noqa: E731
        paths = [f"{field.name}.{axis}" for axis in axes] if code is None else [field.name]
        return dict.fromkeys(field.axis_names(axes), kind), code, paths
    name = field.name.removesuffix("_us") if kind == "epoch" else field.name
    return {name: kind}, code, (f"{field.name}.value" if field.kind is FieldKind.CHOICE else field.name,)


def _table(
    record: type[Any], *, first: Sequence[str] = (), without: Sequence[str] = (), axes: tuple[str, ...] = Axes._fields
) -> SeriesTable[Any]:
    """Return the table of a record: the fields named first, then the others as they stand."""
    known = record_fields(record)
    columns: dict[str, Kind] = {}
    paths: list[str] = []
    codes: list[tuple[int, Code]] = []
    for name in dict.fromkeys((*first, *(name for name in known if name not in without))):
        kinds, code, sources = _columns(known[name], axes)
        if code is not None:
            codes.insert(0, (len(paths), code))
        columns |= kinds
        paths += sources
    plain: Callable[[Any], tuple[Any, ...]] = attrgetter(*paths)

    def values(row: Any) -> Sequence[Any]:
        found = list(plain(row))
        # the last first: a code may give more columns than one
        for position, code in codes:
            found[position : position + 1] = code(found[position])
        return found

    return SeriesTable(tuple(Column(name, kind) for name, kind in columns.items()), values)


#: a field that is added to the row comes last
ATTITUDE: SeriesTable[AttitudeRow] = _table(
    AttitudeRow,
    first=(
        *("epoch_us", "method", "attitude_deg", "sigma_deg", "control_allowed", "downlink_fade", "downlink_fade_db"),
        *("common_db", "carriers_used", "excluded", "status"),
    ),
    without=(
        *("received_at_us", "number", "rates_deg_s", "control_allowed_axes", "residual_rms_db"),
        *("calibration_id", "alignment_id", "advice"),
    ),
)
#: beside the measurement that the row was computed from
JOINED_ATTITUDE: SeriesTable[AttitudeRow] = _table(
    AttitudeRow,
    first=("method", "attitude_deg", "sigma_deg", "protection_deg", "control_allowed", "inhibitions"),
    without=("epoch_us", "received_at_us", "number", "rates_deg_s"),
)
REFERENCES: SeriesTable[AttitudeReference] = _table(AttitudeReference, first=("epoch_us",))
TELEMETRY: SeriesTable[TelemetryRecord] = _table(TelemetryRecord)
POLARIZATION: SeriesTable[PolarizationRecord] = _table(PolarizationRecord, first=("epoch_us",))
TORQUES: SeriesTable[TorqueCommand] = _table(TorqueCommand, without=("number",), axes=_BODY)
EVENTS: SeriesTable[EventRow] = _table(EventRow)


def plain_value(value: Any) -> Any:
    """Return a record, or a part of one, as JSON can hold it: null for what is not finite, RFC 3339 for ``_us``.

    Examples
    --------
    >>> plain_value(Axes(0.5, math.nan, 0.0))
    {'yaw': 0.5, 'roll': None, 'pitch': 0.0}
    """
    if is_dataclass(value) and not isinstance(value, type):
        return dict(_member(field.name, getattr(value, field.name)) for field in fields(value))
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return dict(_member(name, each) for name, each in value._asdict().items())
    if isinstance(value, tuple | list):
        return [plain_value(each) for each in value]
    if isinstance(value, Enum):
        return value.value
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _member(name: str, value: Any) -> tuple[str, Any]:
    if name.endswith("_us") and isinstance(value, int):
        return name.removesuffix("_us"), format_epoch(value)
    return (name.removesuffix("_us") if name.endswith("_us") and value is None else name), plain_value(value)
