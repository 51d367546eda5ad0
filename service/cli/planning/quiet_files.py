"""Files of quiet days for planning: powers as ``soo send`` reads them, the orbit, and points of the beams' gain."""

from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from service.cli.own_data.foreign_archive import ForeignArchive
from service.cli.own_data.foreign_file import carrier_names
from service.cli.own_data.tdm_archive import open_any_archive
from service.errors import InvalidInputError
from service.frontend.backfill.columns import (
    ArchiveError,
    CellError,
    FileColumns,
    match_columns,
    read_epoch,
    read_levels,
)
from service.frontend.backfill.reader import ArchiveFileReader, open_archive
from service.records.epoch import US_PER_S, format_epoch
from service.records.levels.series import MeasurementSeries

if TYPE_CHECKING:
    from service.cli.own_data.importing.manifest import WindowSection
    from service.pipeline.calibration.minute_rows import MinuteRows
    from service.pipeline.planning.beam_contours import ContourPoint
    from service.records.catalogue import CarrierPlan

#: share of unreadable rows beyond which a file is refused, longest gap that is no remark, s
_MOST_UNREADABLE, _GAP_S = 0.01, 1800.0
_CONTOUR_COLUMNS = ("transponder", "latitude_deg", "longitude_deg", "gain_db")


class QuietPowers(NamedTuple):
    """Powers of a file, and remarks on it."""

    rows: "MinuteRows"
    notes: tuple[str, ...]


def read_powers(path: Path, plan: "CarrierPlan") -> QuietPowers:
    """Return the rows of a file in order of epoch.

    Raises
    ------
    InvalidInputError
        ``plan.quiet``: the file cannot be read, holds no carrier, several sources, or rows that mean nothing.
    """
    from service.pipeline.calibration.minute_rows import minute_rows

    rows: dict[int, list[float]] = {}
    faults, sources, count = [], Counter[str](), 0
    try:
        opened, quiet = _opened(path, plan)
        with closing(opened) as archive:
            columns = match_columns(archive.header, plan.carrier_ids)
            for row in archive.rows():
                try:
                    epoch_us, levels = _read_row(row.cells, columns)
                except CellError as error:
                    faults.append(f"line {row.line}: {error}")
                    continue
                if quiet is not None and not quiet.start <= epoch_us < quiet.stop:
                    continue
                rows.setdefault(epoch_us, levels)
                sources[str(row.cells[columns.source]) if columns.source is not None else ""] += 1
                count += 1
    except (ArchiveError, OSError) as error:
        raise InvalidInputError("plan.quiet", str(error)) from None
    if len(sources) > 1:
        raise InvalidInputError("plan.quiet", f"rows of {', '.join(sorted(sources))}; keep those of one source")
    if not rows or len(faults) > _MOST_UNREADABLE * count:
        detail = f"{len(faults)} of {len(faults) + count} rows of {path} cannot be read"
        raise InvalidInputError("plan.quiet", detail + (f"; {faults[0]}" if faults else ": there are none"))
    notes = [
        (faults, f"{len(faults)} rows cannot be read; {faults[0] if faults else ''}"),
        (len(rows) < count, f"{count - len(rows)} rows repeat an epoch; the first of each counts"),
        (columns.left_out, f"columns that are no carrier of the plan: {', '.join(columns.left_out)}"),
        (columns.absent, f"carriers of the plan without powers: {', '.join(columns.absent)}"),
    ]
    ordered = dict(sorted(rows.items()))
    epochs_us = np.array(list(ordered), dtype=np.int64)
    series = MeasurementSeries(plan.carrier_ids, epochs_us, np.array(list(ordered.values()), dtype=np.float64))
    said = [text for applies, text in notes if applies]
    return QuietPowers(minute_rows([series], plan.carrier_ids, ()), (*said, *_gaps(series)))


def _read_row(cells: Sequence[Any], columns: FileColumns) -> tuple[int, list[float]]:
    """Return epoch and levels of a row, NaN = absent; CellError where it means nothing."""
    if len(cells) != len(columns.header):
        raise CellError(f"{len(cells)} cells, the header has {len(columns.header)}", "another number of cells")
    return read_epoch(cells[columns.epoch]), [np.nan if one is None else one for one in read_levels(cells, columns)]


def _gaps(series: MeasurementSeries) -> tuple[str, ...]:
    """Return a remark on the gaps of a series."""
    steps_s = np.diff(series.epochs_us) / US_PER_S
    long = np.flatnonzero(steps_s > _GAP_S)
    if not long.size:
        return ()
    worst = int(long[np.argmax(steps_s[long])])
    longest = f"the longest of {steps_s[worst] / 3600.0:.1f} h from {format_epoch(int(series.epochs_us[worst]))}"
    return (f"{len(long)} gaps beyond half an hour, {longest}",)


def _opened(path: Path, plan: "CarrierPlan") -> tuple[ArchiveFileReader, "WindowSection | None"]:
    """Return a file of powers and its quiet window; a foreign one is read as the manifest of its folder states."""
    from service.cli.own_data.importing.entries import complete_layout
    from service.cli.own_data.importing.manifest import NAME, read_manifest

    if not (path.parent / NAME).exists():
        return open_any_archive(path), None
    manifest = read_manifest(path.parent)
    section = next((each for each in manifest.powers if each.file == path.name), None)
    if section is None:
        return open_any_archive(path), None
    if section.layout().is_empty:
        return open_any_archive(path), manifest.windows.quiet
    carriers = carrier_names([{"id": each.id, "name": each.name} for each in plan.carriers])
    return ForeignArchive(path, complete_layout(path, section, carriers)), manifest.windows.quiet


def read_contours(path: Path) -> "list[ContourPoint]":
    """Return the points of a contour file.

    Raises
    ------
    InvalidInputError
        ``plan.contours``: it cannot be read, or a cell means nothing.
    """
    from service.pipeline.planning.beam_contours import ContourPoint

    points = []
    try:
        with closing(open_archive(path)) as archive:
            if sorted(archive.header) != sorted(_CONTOUR_COLUMNS):
                wanted, found = ", ".join(_CONTOUR_COLUMNS), ", ".join(archive.header[:8])
                raise InvalidInputError("plan.contours", f"{path}: the columns must be {wanted}; they are {found}")
            for row in archive.rows():
                cells = dict(zip(archive.header, row.cells, strict=False))
                try:
                    name, *numbers = (cells[column] for column in _CONTOUR_COLUMNS)
                    latitude_deg, longitude_deg, gain_db = (float(number) for number in numbers)
                except (KeyError, ValueError):
                    raise InvalidInputError("plan.contours", f"{path}, line {row.line}: a cell is no number") from None
                if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 360.0 and np.isfinite(gain_db)):
                    detail = f"{path}, line {row.line}: latitude {latitude_deg:g}, longitude {longitude_deg:g}, gain "
                    detail += f"{gain_db:g} dB is no point of a beam; are latitude and longitude exchanged?"
                    raise InvalidInputError("plan.contours", detail)
                points.append(ContourPoint(row.line, str(name), latitude_deg, longitude_deg, gain_db))
    except (ArchiveError, OSError) as error:
        raise InvalidInputError("plan.contours", str(error)) from None
    return points
