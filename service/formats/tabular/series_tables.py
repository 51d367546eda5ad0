"""Columns of the series that are kept as records: attitude, torques, references, events."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from typing import Any

from service.formats.tabular.table_file import Column, Kind, SeriesTable
from service.records.epoch import format_epoch
from service.records.inputs import AttitudeReference
from service.records.levels.attitude import AttitudeRow, Axes
from service.records.levels.command import Pulse, TorqueCommand


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


def _columns(kinds: Mapping[str, Kind]) -> tuple[Column, ...]:
    return tuple(Column(name, kind) for name, kind in kinds.items())


def _axes_columns(pattern: str, order: Sequence[str] = ("yaw", "roll", "pitch")) -> dict[str, Kind]:
    return {pattern.format(axis): "figure" for axis in order}


_BODY = ("roll", "pitch", "yaw")


def _attitude_values(row: AttitudeRow) -> Sequence[Any]:
    return (
        row.epoch_us,
        row.method.value,
        *row.attitude_deg,
        *row.sigma_deg,
        row.control_allowed,
        row.downlink_fade,
        row.downlink_fade_db,
        row.common_db,
        row.carriers_used,
        ";".join(f"{item.carrier}:{item.reason}" for item in row.excluded),
        row.status.value,
    )


ATTITUDE = SeriesTable(
    _columns(
        {
            "epoch": "epoch",
            "method": "text",
            **_axes_columns("{}_deg"),
            **_axes_columns("{}_sigma_deg"),
            "control_allowed": "truth",
            "downlink_fade": "truth",
            "downlink_fade_db": "figure",
            "common_db": "figure",
            "carriers_used": "count",
            "excluded": "text",
            "status": "text",
        }
    ),
    _attitude_values,
)


def _reference_values(row: AttitudeReference) -> Sequence[Any]:
    return (row.epoch_us, row.source, *row.attitude_deg, *row.sigma_deg)


REFERENCES = SeriesTable(
    _columns({"epoch": "epoch", "source": "text", **_axes_columns("{}_deg"), **_axes_columns("{}_sigma_deg")}),
    _reference_values,
)


def _body(axes: Axes) -> tuple[float, float, float]:
    """Return values in the order in which torques are told."""
    return axes.roll, axes.pitch, axes.yaw


def _pulse(pulse: Pulse) -> dict[str, Any]:
    torque = {f"{axis}_n_m": value for axis, value in zip(_BODY, _body(pulse.torque_n_m), strict=True)}
    return {"start": format_epoch(pulse.start_us), "duration_s": pulse.duration_s, **torque}


def _torque_values(row: TorqueCommand) -> Sequence[Any]:
    check = row.schedule_check
    return (
        row.epoch_us,
        row.attitude_epoch_us,
        row.mode,
        *_body(row.torque_n_m),
        plain_value(row.wheels_n_m),
        row.saturated,
        row.command_period_s,
        row.valid_until_us,
        [_pulse(pulse) for pulse in row.schedule],
        *_body(row.impulse_n_m_s),
        *_body(row.predicted_angle_change_deg),
        *_body(row.predicted_rate_change_deg_s),
        plain_value(row.predicted_wheel_momentum_n_m_s),
        row.control_allowed,
        ";".join(row.inhibitions),
        *((None, None, None) if check is None else (check.verdict, check.peak_deg, check.margin)),
    )


TORQUES = SeriesTable(
    _columns(
        {
            "epoch": "epoch",
            "attitude_epoch": "epoch",
            "mode": "text",
            **_axes_columns("{}_n_m", _BODY),
            "wheels_n_m": "document",
            "saturated": "truth",
            "command_period_s": "figure",
            "valid_until": "epoch",
            "schedule": "document",
            **_axes_columns("{}_impulse_n_m_s", _BODY),
            **_axes_columns("predicted_{}_change_deg", _BODY),
            **_axes_columns("predicted_{}_rate_change_deg_s", _BODY),
            "predicted_wheel_momentum_n_m_s": "document",
            "control_allowed": "truth",
            "inhibitions": "text",
            "schedule_verdict": "text",
            "schedule_peak_deg": "figure",
            "schedule_margin": "figure",
        }
    ),
    _torque_values,
)


def _event_values(row: EventRow) -> Sequence[Any]:
    return (row.epoch_us, row.stop_us, row.number, row.kind, row.key, row.document)


EVENTS = SeriesTable(
    _columns(
        {
            "epoch": "epoch",
            "stop": "epoch",
            "number": "count",
            "kind": "text",
            "key": "text",
            "document": "document",
        }
    ),
    _event_values,
)


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
    """Return name and value of one field."""
    if name.endswith("_us") and isinstance(value, int):
        return name.removesuffix("_us"), format_epoch(value)
    return (name.removesuffix("_us") if name.endswith("_us") and value is None else name), plain_value(value)
