"""Messages of a small archive for the readers of other people: run by the service's own Python.

``python -m tests.clients.write_messages FOLDER`` stores rows through the ports, writes what the service exports of
them, and beside it ``archive.json``: the same rows as the archive tells them.
"""

import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from db.storage import SqlStorage
from service.api.export.export_files import FileFormat, FileOrder, archive_file
from service.core.geometry.frames import attitude_of_quaternion
from service.formats.ccsds import AemWriter, AttitudeMessage
from service.ports.archive import LIVE, ListPart, Outcome
from service.records.calibration import Window
from service.records.catalogue import Carrier, Method, Site, Spacecraft, Station
from service.records.levels.attitude import AttitudeRow, Axes, Status, row_without_attitude
from service.records.levels.measurement import CarrierDetails, Measurement, MeasurementBatch, QualityFlag

#: 2026-11-21T00:00:00Z
START_US = 1_795_219_200_000_000
STEP_US = 10_250_001
ROWS, CARRIERS, SEED = 400, 4, 17
SC = "yamal-202"
#: message of the GSFC, as Orekit tests its reader: ZXZ 5.798977, 25.098268, -144.066452 deg
GOLDEN = (0.056482, 0.209807, -0.912091, 0.347679)
EVERYTHING = Window(START_US - 10**12, START_US + 10**12)


def main(folder: Path) -> None:
    """Write all files."""
    storage = SqlStorage(f"sqlite:///{folder / 'archive.db'}")
    storage.prepare()
    rows = fill(storage)
    write(storage, folder / "powers.tdm", "measurements", "tdm")
    write(storage, folder / "attitude.aem", "attitude", "aem")
    attitude = storage.results.attitude_rows(SC, LIVE, Method.ROBUST, ListPart(EVERYTHING, 10_000))
    document = {
        "powers": [
            {
                "epoch_us": row.epoch_us,
                "source": row.source,
                "power_dbm": plain(row.power_dbm),
                "c_n0_db_hz": None if row.details is None else plain(row.details.c_n0_db_hz),
                "flags": None if row.flags is None else row.flags.tolist(),
            }
            for row in rows
        ],
        "attitude": [{"epoch_us": row.epoch_us, "attitude_deg": plain(row.attitude_deg)} for row in attitude],
        "seconds_of_a_day": write_day(folder / "day.aem"),
    }
    storage.close()
    (folder / "archive.json").write_text(json.dumps(document))
    golden = attitude_row(1, START_US, Axes(*attitude_of_quaternion(GOLDEN)))
    write_rows(folder / "golden.aem", [golden])


def fill(storage: SqlStorage) -> list[Measurement]:
    """Store levels, flags, ratios and angles with a gap and rows without a value; return the rows."""
    rng = np.random.default_rng(SEED)
    inertia = ((2600.0, 0.0, 0.0), (0.0, 1400.0, 0.0), (0.0, 0.0, 2600.0))
    site = Site(56.7, 37.2, "Dubna")
    storage.catalogue.add_spacecraft(Spacecraft(SC, "Ямал-202", 90.0, site, inertia, 0.05, cospar_id="2003-053B"))
    carriers = [
        Carrier(f"c{k:02d}", "Ku", "Ku1", 11.2e9 + k * 2e6, 1.25e6, Station(50.0, 40.0 + k), 14.25e9, name=f"№{k}")
        for k in range(CARRIERS)
    ]
    plan = storage.catalogue.put_plan(SC, carriers, "plan")
    numbers = np.delete(np.arange(ROWS), slice(200, 260))
    epochs_us = START_US + STEP_US * numbers
    shape = (len(epochs_us), CARRIERS)
    levels = rng.uniform(-120.0, -40.0, shape).astype(np.float32)
    levels[rng.random(shape) < 0.05] = np.nan
    c_n0, nothing = rng.uniform(60.0, 80.0, shape), np.full(shape, np.nan)
    c_n0[:, 3] = np.nan
    overrange = int(QualityFlag.OVERRANGE)
    for source, flags in (
        ("sa-1", tuple((0, 0, overrange * (k % 7 == 0), 0) for k in range(shape[0]))),
        ("sa-2", None),
    ):
        batch = MeasurementBatch(
            SC,
            source,
            plan.id,
            START_US,
            np.arange(shape[0]),
            epochs_us,
            levels if source == "sa-1" else levels + 1,
            (None,) * shape[0] if flags is None else flags,
            np.zeros(shape[0], dtype=bool),
            details=CarrierDetails(nothing, c_n0, nothing, nothing) if source == "sa-1" else None,
        )
        assert storage.archive.append_measurements(batch).result(30).accepted == shape[0]
    rows = storage.archive.measurements(SC, ListPart(EVERYTHING, 10_000))
    angles = rng.uniform(-2.0, 2.0, (len(rows), 3))
    angles[::11] = np.nan
    outcomes = [
        Outcome((attitude_row(row.number, row.epoch_us, Axes(*each)),), None)
        for row, each in zip(rows, angles.tolist(), strict=True)
        if row.feeds_estimator
    ]
    head = storage.archive.head(SC)
    storage.results.save_outcomes(SC, LIVE, outcomes, head.newest_number, head.newest_epoch_us)
    return rows


def attitude_row(number: int, epoch_us: int, angles: Axes) -> AttitudeRow:
    """Return a row with angles, or one without."""
    blank = row_without_attitude(epoch_us, epoch_us, number, Method.ROBUST, ())
    if not np.isfinite(angles).all():
        return blank
    sigma = Axes(0.08, 0.014, 0.02)
    return replace(blank, attitude_deg=angles, sigma_deg=sigma, status=Status.ACQUIRED, calibration_id=7)


def write(storage: SqlStorage, path: Path, series: str, file_format: FileFormat) -> None:
    """Write what the service exports."""
    clock = SimpleNamespace(system_us=lambda: START_US)
    context = cast("Any", SimpleNamespace(storage=storage, clock=clock))
    order = FileOrder(SC, series, file_format, EVERYTHING)
    file = archive_file(context, lambda sc, plan_id: storage.catalogue.plan(sc, plan_id).carrier_ids, order)
    with path.open("wb") as output:
        output.writelines(file.write(file.read(EVERYTHING), EVERYTHING))


def write_rows(path: Path, rows: Sequence[AttitudeRow]) -> None:
    """Write attitude rows as a message."""
    writer = AemWriter(AttitudeMessage("YAMAL-202", "2003-053B", "m-1", START_US, "robust live"))
    with path.open("wb") as output:
        output.write(writer.header())
        output.writelines(writer.segments([rows]))


def write_day(path: Path) -> float:
    """Write a day of one row a second; return the seconds that it took, the best of three."""
    rows = [attitude_row(k + 1, START_US + 1_000_000 * k, Axes(0.1, -0.001 * (k % 100), 0.02)) for k in range(86_400)]

    def taken() -> Iterator[float]:
        for _ in range(3):
            began_s = time.perf_counter()
            write_rows(path, rows)
            yield time.perf_counter() - began_s

    return min(taken())


def plain(values: Any) -> list[float | None]:
    """Return numbers with None for NaN."""
    return [None if np.isnan(value) else float(value) for value in values]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
