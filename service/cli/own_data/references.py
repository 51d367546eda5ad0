"""``soo references``: readings of an attitude sensor from CSV, Parquet, AEM or JSON.

Exit codes: 0 stored or known, or understood with ``--dry-run``, 1 the service refused the request or did not answer
(run the same command again), 2 the file is none of these, or something must be stated (standard error has the options),
3 rows could not be read or were refused.
"""

import shlex
from collections.abc import Callable, Iterator
from enum import StrEnum
from itertools import islice, starmap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from service.cli.command_group import end, new_app
from service.cli.operation.connection import (
    DEFAULT_KEY_ENVIRONMENT,
    DEFAULT_SERVICE,
    JsonOption,
    KeyEnvironment,
    ServiceUrl,
    SpacecraftOption,
    connected,
)
from service.cli.own_data.document_file import EXIT_DIFFERENT, decoded, read_text, report, show
from service.records.epoch import US_PER_S, format_epoch

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient
    from service.formats.foreign.sensor import SensorProposal, StatedSensor
    from service.frontend.backfill.survey import Survey

_BATCH_ROWS = 5000
_FUTURE_US = 60 * US_PER_S
_CHECKED = "epochs, unit length of quaternions, position of the scalar, roll and pitch within the Earth's disc"
_NOT_CHECKED = (
    "signs of the axes and direction of the rotation: compare the spans with turns that you know"
    " (positive roll moves stations South, positive pitch West, positive yaw those in the East to the North)"
)


class Reading(NamedTuple):
    """Yaw, roll and pitch at one epoch, None = absent."""

    epoch_us: int
    angles_deg: list[float | None]
    #: one standard deviation by axis; None: not stated by the file
    sigma_deg: dict[str, float | None] | None = None


class UnreadableLine(NamedTuple):
    """A line without a reading, and why."""

    line: int
    kind: str
    detail: str


Lines = Iterator[Reading | UnreadableLine]
app = new_app(help="Readings of an attitude sensor.", no_args_is_help=True)


class SensorName(StrEnum):
    """Sensor under which readings are stored."""

    STAR_TRACKER = "star_tracker"
    EARTH_SENSOR = "earth_sensor"
    RADIO_BEACON = "radio_beacon"
    OTHER = "other"


class ScalarEnd(StrEnum):
    """Position of the scalar of a quaternion."""

    FIRST = "first"
    LAST = "last"


@app.callback()
def group() -> None:
    """Store readings of an attitude sensor."""


@app.command()
def put(
    file: Annotated[Path, typer.Argument(help="CSV, Parquet, AEM or JSON file.", dir_okay=False, exists=True)],
    *,
    spacecraft: SpacecraftOption,
    source: Annotated[SensorName, typer.Option(help="Sensor of the readings.")] = SensorName.STAR_TRACKER,
    time_column: Annotated[
        list[str] | None, typer.Option(help="Column of the epochs; date and time: state both.")
    ] = None,
    time_format: Annotated[
        str | None, typer.Option(help="`iso`, `unix_s`, `unix_ms`, `unix_us`, or a pattern: %d.%m.%Y %H:%M:%S.")
    ] = None,
    tz: Annotated[
        str | None, typer.Option(help="Zone of epochs without an offset: UTC, +03:00, Europe/Moscow.")
    ] = None,
    unit: Annotated[str | None, typer.Option(help="Unit of the angles: deg, rad, mrad, arcmin or arcsec.")] = None,
    scalar: Annotated[ScalarEnd | None, typer.Option(help="Position of the scalar of quaternions.")] = None,
    map_: Annotated[list[str] | None, typer.Option("--map", help="NAME=AXIS: column, and yaw, roll or pitch.")] = None,
    sigma_deg: Annotated[
        list[str] | None, typer.Option(help="AXIS=DEG: one standard deviation of an axis, deg.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what is understood, store nothing.")] = False,
    service: ServiceUrl = DEFAULT_SERVICE,
    key_env: KeyEnvironment = DEFAULT_KEY_ENVIRONMENT,
    as_json: JsonOption = False,
) -> None:
    """Store readings of a CSV, Parquet, AEM or JSON file."""
    from service.cli.own_data.foreign_file import stated_pairs
    from service.formats.foreign.layout import StatedLayout
    from service.formats.foreign.sensor import StatedSensor

    time = StatedLayout(tuple(time_column or ()), time_format, tz)
    columns = stated_pairs(map_ or [], "--map", "NAME=AXIS")
    stated = StatedSensor(time, unit, None if scalar is None else scalar.value, columns)
    sigma = _sigma(stated_pairs(sigma_deg or [], "--sigma-deg", "AXIS=DEG"))
    readings, understood = _opened(file, spacecraft, source.value, stated)
    survey = _surveyed(file, readings)
    with connected(service, key_env, timeout_s=60.0) as client:
        understood |= _summary(survey)
        if not as_json:
            show(str(file), ((name, str(value)) for name, value in understood.items()))
        _check(file, survey, is_simulated=client.spacecraft(spacecraft).get("simulated", False))
        counts = {} if dry_run else _send(client, spacecraft, source.value, readings, sigma)
    sentence = ", ".join(f"{count} {name}" for name, count in counts.items()) or "nothing was stored"
    report(understood | counts, as_json=as_json, sentence=sentence)
    if survey.faults.rows or counts.get("refused"):
        raise typer.Exit(EXIT_DIFFERENT)


def _sigma(stated: dict[str, str]) -> dict[str, float]:
    """Return standard deviations by axis, or end."""
    from service.formats.foreign.sensor import AXES

    try:
        sigma = {axis: float(value) for axis, value in stated.items()}
    except ValueError as error:
        end(f"--sigma-deg: {error}", cause=error)
    wrong = [axis for axis, value in sigma.items() if axis not in AXES or not 0.0 < value <= 180.0]
    if wrong:
        end(f"--sigma-deg {wrong[0]}={stated[wrong[0]]}: write yaw, roll or pitch, and degrees above 0")
    return sigma


def _opened(
    file: Path, spacecraft: str, source: str, stated: "StatedSensor"
) -> tuple[Callable[[], Lines], dict[str, Any]]:
    """Return what reads a file from its beginning, and how it is understood; end where something must be stated."""
    from service.cli.own_data.foreign_archive import sample_of, table_rows
    from service.formats.foreign.attitude_message import read_attitude_message
    from service.formats.foreign.fault import ForeignCellError, ForeignTableError
    from service.formats.foreign.sensor import propose_sensor
    from service.frontend.backfill.columns import ArchiveError

    try:
        with file.open("rb") as opened:
            start = opened.read(200).removeprefix(b"\xef\xbb\xbf").lstrip()
        if start.startswith((b"{", b"CCSDS_AEM_VERS")):
            is_json = start.startswith(b"{")
            rows = (
                _from_json(file, source) if is_json else list(starmap(Reading, read_attitude_message(read_text(file))))
            )
            return lambda: iter(rows), {"form": "JSON" if is_json else "AEM"}
        proposal = propose_sensor(sample_of(file), stated)
    except (ForeignTableError, ArchiveError, OSError) as error:
        text = str(error)
        end(text if str(file) in text else f"{file}: {text}", cause=error)
    reader = proposal.reader
    if reader is None:
        end(_statement(file, spacecraft, proposal))

    def readings() -> Lines:
        for row in table_rows(file):
            if row.fault is not None:
                yield UnreadableLine(row.line, row.fault, row.fault)
                continue
            try:
                yield Reading(*reader.read(row.cells))
            except ForeignCellError as error:
                yield UnreadableLine(row.line, error.kind, str(error))

    return readings, {"form": "table", **proposal.understood}


def _from_json(file: Path, source: str) -> list[Reading]:
    """Return the readings of a document of the interface, or end."""
    from pydantic import TypeAdapter

    from service.api.schemas.inputs import ReferenceBatchDocument

    document = decoded(file, TypeAdapter(ReferenceBatchDocument), read_text(file).encode())
    if document.source != source:
        end(f"{file} holds readings of {document.source}; state --source {document.source}")
    return [
        Reading(
            each.epoch,
            [each.yaw_deg, each.roll_deg, each.pitch_deg],
            None if each.sigma_deg is None else each.sigma_deg.model_dump(),
        )
        for each in document.references
    ]


def _statement(file: Path, spacecraft: str, proposal: "SensorProposal") -> str:
    """Return what must be stated, and the command to complete."""
    lines = [f"{file}: this must be stated, it is not guessed:"]
    command = shlex.join(["soo", "references", "put", str(file), "--spacecraft", spacecraft])
    for option, text, choices, _ in proposal.questions:
        lines.append(f"  {option}: {text}" + (f" [{', '.join(choices[:20])}]" if choices else ""))
        command += f" {option} {'NAME=AXIS' if option == '--map' else option.removeprefix('--').upper()}"
    return "\n".join((*lines, "State it:", f"  {command}"))


def _surveyed(file: Path, readings: Callable[[], Lines]) -> "Survey":
    """Return the survey of all readings, or end where a file cannot be read to its end."""
    from service.formats.foreign.sensor import AXES
    from service.frontend.backfill.columns import ArchiveError
    from service.frontend.backfill.survey import Survey

    survey = Survey(AXES)
    try:
        for each in readings():
            if isinstance(each, UnreadableLine):
                survey.faults.add(each.kind, each.line, each.detail)
            elif any(angle is not None for angle in each.angles_deg):
                survey.add(each.epoch_us, each.angles_deg)
            else:
                survey.faults.add("no angle", 0, format_epoch(each.epoch_us))
    except ArchiveError as error:
        end(str(error), cause=error)
    if not survey.rows:
        faults = survey.faults.as_documents()
        end(f"{file}: no reading" + (f"; {faults[0]['kind']}: {faults[0]['detail']}" if faults else ""))
    return survey


def _summary(survey: "Survey") -> dict[str, Any]:
    """Return a survey for a report."""
    from service.formats.foreign.sensor import AXES

    order = survey.order()
    angles = {
        f"{axis}_deg": f"{span.least:+.4f} to {span.greatest:+.4f}, mean {span.total / span.present:+.4f}"
        if span.present
        else "absent"
        for axis, span in zip(AXES, survey.spans, strict=True)
    }
    start, stop = (format_epoch(epoch_us or 0) for epoch_us in (survey.start_us, survey.stop_us))
    counts = {"rows": survey.rows, "duplicate_epochs": order.duplicates, "gaps": len(order.gaps_us)}
    faults = {"unreadable": survey.faults.rows, "faults": survey.faults.as_documents()} if survey.faults.rows else {}
    checks = {"checked": _CHECKED, "not_checked": _NOT_CHECKED}
    return {"start": start, "stop": stop, **counts, **angles, **faults, **checks}


def _check(file: Path, survey: "Survey", *, is_simulated: bool) -> None:
    """End when the readings cannot be those of this spacecraft."""
    from service.formats.foreign.sensor import AXES, EARTH_DISC_DEG
    from service.runtime.clock import system_now_us

    stop_us = survey.stop_us or 0
    if not is_simulated and stop_us > system_now_us() + _FUTURE_US:
        end(f"{file}: the newest epoch {format_epoch(stop_us)} lies in the future; is --tz right?")
    for axis, span in zip(AXES, survey.spans, strict=True):
        mean_deg = span.total / span.present if span.present else 0.0
        if axis != "yaw" and abs(mean_deg) > EARTH_DISC_DEG:
            end(
                f"{file}: {axis} is {mean_deg:+.2f} deg in the mean, and the Earth's disc ends at {EARTH_DISC_DEG} deg;"
                " check unit, axes and frame (angles from the nadir frame to the body are wanted)"
            )


def _send(
    client: "ServiceClient",
    spacecraft: str,
    source: str,
    readings: Callable[[], Lines],
    sigma_deg: dict[str, float],
) -> dict[str, int]:
    """Send all readings and return what became of them; repeating them is safe."""
    counts = {"accepted": 0, "duplicates": 0, "refused": 0}
    rows = (each for each in readings() if isinstance(each, Reading) and each.angles_deg != [None, None, None])
    while batch := [_document(each, sigma_deg) for each in islice(rows, _BATCH_ROWS)]:
        reply = client.post_references(spacecraft, source, batch)
        counts["accepted"] += reply["accepted"]
        counts["duplicates"] += reply["duplicates"]
        counts["refused"] += len(reply["refused"])
    return counts


def _document(reading: Reading, stated_sigma_deg: dict[str, float]) -> dict[str, Any]:
    """Return one reading as the interface has it; stated deviations go before those of the file."""
    yaw_deg, roll_deg, pitch_deg = reading.angles_deg
    angles = {"yaw_deg": yaw_deg, "roll_deg": roll_deg, "pitch_deg": pitch_deg}
    sigma_deg = stated_sigma_deg or reading.sigma_deg
    return {"epoch": format_epoch(reading.epoch_us), **angles} | ({"sigma_deg": sigma_deg} if sigma_deg else {})
