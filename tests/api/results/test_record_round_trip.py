"""Every field of a row and of a command, each with a value of its own, through database, interface, client and export.

Values are made from the types of the fields, so a field that is added is tested without a change here.
"""

import io
import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import httpx
import pyarrow.parquet
import pytest

from service.client.async_service_client import AsyncServiceClient
from service.client.documents import Attitude
from service.ports.archive import LIVE, Outcome
from service.records.epoch import format_epoch
from service.records.levels.attitude import Axes, Exclusion, Pulse, ScheduleVerdict
from service.records.record_fields import FieldKind, RecordField, record_fields

pytestmark = pytest.mark.anyio
#: fields that name the row; the archive gives them
OF_THE_ROW = {"epoch_us", "received_at_us", "number", "method", "mode"}
#: fields that exports have never had; a field that is added is exported
NOT_EXPORTED = {
    *("number", "received_at_us", "rates_deg_s", "control_allowed_axes", "residual_rms_db"),
    *("calibration_id", "alignment_id", "advice"),
}


def distinct(field: RecordField, position: int, epoch_us: int) -> Any:
    """Return a value that no other field has."""
    axes = Axes(position + 0.125, -position - 0.25, position + 0.375)
    values = {
        FieldKind.EPOCH: epoch_us + position,
        FieldKind.COUNT: 100 + position,
        FieldKind.NUMBER: position + 0.5,
        FieldKind.TRUTH: True,
        FieldKind.TEXT: field.name,
        FieldKind.CHOICE: list(field.content)[-1] if field.kind is FieldKind.CHOICE else None,
        FieldKind.TEXTS: (field.name, str(position)),
        FieldKind.AXES: axes,
        FieldKind.AXIS_TRUTHS: (True, False, True),
        FieldKind.RECORD: ScheduleVerdict(
            "reject", position + 0.1, position + 0.2, position + 0.3, position, field.name
        ),
    }
    elements = {
        float: position + 0.625,
        Exclusion: Exclusion(field.name, "step"),
        Pulse: Pulse(epoch_us, position + 0.5, axes),
    }
    return (elements[field.content],) * 2 if field.kind is FieldKind.RECORDS else values[field.kind]


def filled(record: Any) -> Any:
    """Return a record with a value of its own in every field."""
    fields = record_fields(type(record))
    positions = enumerate(name for name in fields if name not in OF_THE_ROW)
    return replace(record, **{name: distinct(fields[name], position, record.epoch_us) for position, name in positions})


def members(record: Any) -> Iterator[tuple[str, Any]]:
    """Yield the members that an answer must have for the fields of an attitude row."""
    for name, field in record_fields(type(record)).items():
        value = getattr(record, name)
        match field.kind:
            case FieldKind.EPOCH:
                yield name.removesuffix("_us"), format_epoch(value)
            case FieldKind.AXES if name == "attitude_deg":
                yield from zip(("yaw_deg", "roll_deg", "pitch_deg"), value, strict=True)
            case FieldKind.AXES | FieldKind.AXIS_TRUTHS:
                yield name, dict(zip(Axes._fields, value, strict=True))
            case FieldKind.TEXTS:
                yield name, list(value)
            case FieldKind.RECORDS:
                yield name, [each._asdict() for each in value]
            case _ if name != "number":
                yield name, value


def cells(record: Any) -> Iterator[tuple[str, Any]]:
    """Yield the cells that a file must have for the fields of a record."""
    for name, field in record_fields(type(record)).items():
        value = getattr(record, name)
        if name in NOT_EXPORTED:
            continue
        match field.kind:
            case FieldKind.EPOCH:
                yield name.removesuffix("_us"), format_epoch(value)
            case FieldKind.AXES | FieldKind.AXIS_TRUTHS:
                yield from zip(field.axis_names(), value, strict=True)
            case FieldKind.TEXTS:
                yield name, ";".join(value)
            case FieldKind.RECORD:
                yield from (("schedule_verdict", value.verdict), ("schedule_peak_deg", value.peak_deg))
                yield "schedule_margin", value.margin
            case FieldKind.RECORDS if field.content is Exclusion:
                yield name, ";".join(f"{each.carrier}:{each.reason}" for each in value)
            case FieldKind.RECORDS if field.content is float:
                yield name, list(value)
            case FieldKind.RECORDS:
                torques = [each.torque_n_m._asdict() for each in value]
                lengths = [{"start": format_epoch(each.start_us), "duration_s": each.duration_s} for each in value]
                named = [{f"{axis}_n_m": torque for axis, torque in each.items()} for each in torques]
                yield name, [{**length, **torque} for length, torque in zip(lengths, named, strict=True)]
            case _:
                yield name, value


async def exported(bench: Any, series: str) -> dict[str, Any]:
    """Return the only row of an export, which Parquet must have too."""
    path, stretch = f"{bench.url}/archive/{series}:export", {"start": "2026-11-01T00:00:00Z"}
    lines = await bench.client.get(path, params={"format": "ndjson", **stretch})
    row: dict[str, Any] = json.loads(lines.text)
    file = await bench.client.get(path, params={"format": "parquet", **stretch})
    (stored,) = pyarrow.parquet.read_table(io.BytesIO(file.content)).to_pylist()
    for name, value in stored.items():
        is_document = isinstance(value, str) and isinstance(row[name], list)
        plain = json.loads(value) if is_document else value
        assert (format_epoch(round(plain.timestamp() * 1e6)) if hasattr(plain, "timestamp") else plain) == row[name]
    return row


async def test_every_field_of_a_row_and_of_a_command_arrives(bench, make):
    (measurement,) = bench.append([make.now_us])
    row, command = filled(make.row(measurement)), filled(make.command(measurement))
    bench.consume([Outcome((row,), command)])
    results = bench.storage.results
    assert results.newest_attitude(make.sc, LIVE, row.method) == row
    assert results.newest_command(make.sc, LIVE) == command
    assert [result for _, result in results.results_after(make.sc, 0, 10)] == [row, command]
    transport = httpx.ASGITransport(app=bench.app)
    async with AsyncServiceClient("http://soo.test", make.key, http=transport) as client:
        (answer,) = [each async for each in client.attitude_history(make.sc, method=row.method)]
    assert answer == {**dict(members(row)), "version": LIVE}
    assert answer.keys() == Attitude.__annotations__.keys() - {"control"}
    assert await exported(bench, "attitude") == dict(cells(row))
    assert await exported(bench, "torques") == dict(cells(command))
