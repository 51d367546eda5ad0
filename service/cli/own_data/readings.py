"""Readings of an attitude sensor in a file: opened, surveyed, judged and sent."""

from collections.abc import Callable, Iterator
from itertools import islice, starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from service.cli.command_group import end
from service.cli.own_data.document_file import decoded, read_text
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


def open_readings(
    file: Path, source: str, stated: "StatedSensor", statement: Callable[["SensorProposal"], str]
) -> tuple[Callable[[], Lines], dict[str, Any]]:
    """Return what reads a file from its beginning, and how it is understood; end where something must be stated.

    Parameters
    ----------
    file : Path
        CSV, Parquet, AEM or JSON.
    source : str
        Sensor that a document of the interface must name.
    stated : StatedSensor
        Layout as far as a person stated it.
    statement : callable
        Returns the text that says what must be stated.
    """
    from service.cli.own_data.foreign_archive import sample_of, table_rows
    from service.formats.foreign.layout import ForeignCellError, ForeignTableError
    from service.formats.foreign.sensor import propose_sensor
    from service.frontend.backfill.columns import ArchiveError

    try:
        with file.open("rb") as opened:
            start = opened.read(200).removeprefix(b"\xef\xbb\xbf").lstrip()
        if start.startswith((b"{", b"CCSDS_AEM_VERS", b"COMMENT", b"<")):
            is_json = start.startswith(b"{")
            rows = _from_json(file, source) if is_json else _from_message(file)
            return lambda: iter(rows), {"form": "JSON" if is_json else "AEM"}
        proposal = propose_sensor(sample_of(file), stated)
    except (ForeignTableError, ArchiveError, OSError) as error:
        text = str(error)
        end(text if str(file) in text else f"{file}: {text}", cause=error)
    reader = proposal.reader
    if reader is None:
        end(statement(proposal))

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


def _from_message(file: Path) -> list[Reading]:
    """Return the readings of an AEM."""
    from service.formats.foreign.messages import read_attitude_message

    epochs_us, angles_deg = read_attitude_message(read_text(file))
    return list(starmap(Reading, zip(epochs_us.tolist(), angles_deg.tolist(), strict=True)))


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


def survey_of(file: Path, readings: Callable[[], Lines]) -> "Survey":
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


def summary_of(survey: "Survey") -> dict[str, Any]:
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


def check_readings(file: Path, survey: "Survey", *, is_simulated: bool) -> None:
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


def send_readings(
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
