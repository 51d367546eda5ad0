"""Rows of the chain over simulated worlds, kept as Parquet, and how two such sets differ.

``python -m bench.oracle write DIR`` at the commit that is trusted, the same into another folder after a change, then
``python -m bench.oracle compare DIR OTHER``: numbers may differ by 1e-9 (deg, dB, N m s), words and decisions not at
all. A row holds a measurement, what one method made of it and of each carrier, and the command that followed. Exit code
1 where the sets differ. A world of two days takes some 10 s of a core.
"""

import argparse
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from service.formats.tabular.measurement_file import MeasurementColumns
from service.formats.tabular.series_tables import JoinedRow, joined_table
from service.formats.tabular.table_file import table_bytes
from service.records.catalogue import ControlMode, ControlSettings, Method, Release
from service.study.estimation.campaign import GROUPS, SNAPSHOT
from service.study.estimation.flight.drive import UndrivenError, open_chain
from service.study.estimation.flight.world import Ground, export_world, read_world

#: most by which a number may differ
TOLERANCE = 1e-9
#: rows of a page of a file
PAGE_ROWS = 1000


class Unit(NamedTuple):
    """One world, driven by one method."""

    scenario: str
    seed: int
    method: Method
    directory: Path

    @property
    def path(self) -> Path:
        """File of its rows."""
        return self.directory / f"{self.scenario}-{self.seed}-{self.method}.parquet"


def main() -> int:
    """Write or compare; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    write = commands.add_parser("write")
    write.add_argument("directory", type=Path)
    write.add_argument("--scenario", action="append", default=[])
    write.add_argument("--seeds", type=int, default=10)
    write.add_argument("--jobs", type=int, default=2)
    comparison = commands.add_parser("compare")
    comparison.add_argument("directory", type=Path)
    comparison.add_argument("other", type=Path)
    options = parser.parse_args()
    if options.command == "compare":
        return compare(options.directory, options.other)
    every = dict.fromkeys(name for group in GROUPS.values() for name in group if name != SNAPSHOT)
    options.directory.mkdir(parents=True, exist_ok=True)
    units = [
        Unit(name, seed, method, options.directory)
        for name in options.scenario or every
        for seed in range(1, options.seeds + 1)
        for method in (Method.ROBUST, Method.PAPER)
    ]
    with ProcessPoolExecutor(options.jobs) as pool:
        for line in pool.map(write_unit, (unit for unit in units if not unit.path.exists())):
            print(line, flush=True)
    return 0


def write_unit(unit: Unit) -> str:
    """Write the rows of a unit and return a line about them."""
    with TemporaryDirectory() as directory:
        world = Path(directory) / "world.npz"
        export_world(unit.scenario, unit.seed, world)
        ground = read_world(world).ground
    control = ControlSettings(unit.method, ControlMode.GROUND, Release.AUTOMATIC)
    ground = replace(ground, spacecraft=replace(ground.spacecraft, control=control))
    try:
        rows = list(joined_rows(ground, unit.method))
    except UndrivenError as error:
        return f"{unit.path.stem}: {error}"
    plans = {1: tuple(carrier.id for carrier in ground.carriers)}
    for event in ground.events:
        if isinstance(event.content, tuple):
            plans[len(plans) + 1] = tuple(carrier.id for carrier in event.content)
    table = joined_table(MeasurementColumns(list(plans.values()), plans.__getitem__))
    pages = (rows[first : first + PAGE_ROWS] for first in range(0, len(rows), PAGE_ROWS))
    unit.path.write_bytes(b"".join(table_bytes(table, "parquet", pages)))
    return f"{unit.path.stem}: {len(rows)} rows"


def joined_rows(ground: Ground, method: Method) -> Iterator[JoinedRow]:
    """Yield each row of operation with what a method, which drives control, made of it."""
    opened = open_chain(ground)
    for measurement in opened.measurements(ground):
        outcome = opened.chain.step(measurement)
        rows = () if outcome is None else outcome.rows
        k = next((k for k, row in enumerate(rows) if row.method is method), None)
        if outcome is None or k is None:
            yield JoinedRow(measurement, None, None, None)
            continue
        carriers = outcome.carriers[k] if outcome.carriers else None
        yield JoinedRow(measurement, rows[k], carriers, outcome.command)


def compare(directory: Path, other: Path) -> int:
    """Print how two sets differ, a line a file; return the exit code."""
    names = sorted({path.name for folder in (directory, other) for path in folder.glob("*.parquet")})
    found = [f"{name}: {text}" for name in names if (text := difference(directory / name, other / name))]
    print("\n".join([*found, f"{len(names)} files, {len(found)} differ"]))
    return 1 if found or not names else 0


def difference(one: Path, other: Path) -> str:
    """Return what differs between two files, empty where nothing does."""
    if not (one.exists() and other.exists()):
        return "in one set alone"
    tables = parquet.read_table(one), parquet.read_table(other)
    if tables[0].num_rows != tables[1].num_rows or tables[0].column_names != tables[1].column_names:
        return "other rows or columns"
    texts = []
    for name in tables[0].column_names:
        rows = _unequal_rows(tables[0][name], tables[1][name])
        if len(rows):
            texts.append(f"{name} in {len(rows)} rows, first {rows[0]}")
    return "; ".join(texts)


def _unequal_rows(one: pa.ChunkedArray, other: pa.ChunkedArray) -> np.ndarray:
    """Return the rows in which two columns differ."""
    if pa.types.is_floating(one.type):
        left, right = one.to_numpy(), other.to_numpy()
        return np.flatnonzero(~np.isclose(left, right, rtol=0.0, atol=TOLERANCE, equal_nan=True))
    pairs = zip(one.to_pylist(), other.to_pylist(), strict=True)
    return np.array([row for row, (left, right) in enumerate(pairs) if left != right], dtype=np.int64)


if __name__ == "__main__":
    sys.exit(main())
