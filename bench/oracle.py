"""Rows of the chain over simulated worlds and recorded flights, kept as Parquet, and how two such sets differ.

``python -m bench.oracle write DIR`` at the commit that is trusted, the same into another folder after a change, then
``python -m bench.oracle compare DIR OTHER``: numbers may differ by 1e-9 (deg, dB, N m s), words and decisions not at
all. A row holds a measurement, what one method made of it and of each carrier, and the command that followed. Exit code
1 where the sets differ. A world of two days takes some 10 s of a core.

A closed loop answers to every digit of its angles, so it is flown once: ``record FLIGHTS`` keeps what its chain was
given, and ``write DIR --flights FLIGHTS`` makes rows of that.
"""

import argparse
import pickle
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from service.formats.series_tables import JoinedRow, joined_table
from service.formats.table_file import MeasurementColumns, table_bytes
from service.pipeline.chain import Chain, ChainRow
from service.pipeline.config import ChainConfig
from service.pipeline.inputs.knowledge import JournalDocuments
from service.ports.archive import Outcome
from service.records.catalogue import ControlMode, ControlSettings, Method, Release
from service.records.inputs import SlowInput
from service.records.levels.measurement import Measurement
from service.study.closed_loop import run
from service.study.closed_loop.controllers import Sensing
from service.study.estimation.campaign import GROUPS, SNAPSHOT
from service.study.estimation.flight.drive import UndrivenError, open_chain
from service.study.estimation.flight.world import simulated_world

#: most by which a number may differ
TOLERANCE = 1e-9
#: closed loops that are recorded
LOOPS = ("nominal", "steps", "downlink_rain", "slew_fade", "unknown_residual_daily", "wheels_unstated", "plant_varied")
#: rows of a page of a file
PAGE_ROWS = 1000


class Unit(NamedTuple):
    """One world, driven by one method, or one recorded flight."""

    name: str
    seed: int
    method: Method
    directory: Path
    #: journal of a flight; None: a world
    flight: Path | None = None

    @property
    def path(self) -> Path:
        """File of its rows."""
        return self.directory / f"{self.name}-{self.seed}-{self.method}.parquet"


class Flight(NamedTuple):
    """Journal of the chain of a closed loop, in order."""

    documents: JournalDocuments
    entries: list[Measurement | SlowInput]


class RecordedChain(Chain):
    """Chain that keeps what it is given."""

    def __init__(self, documents: JournalDocuments, *given: Any, **named: Any) -> None:
        self.flight = Flight(documents, [])
        super().__init__(documents, *given, **named)

    def update(self, content: SlowInput) -> None:
        """Take an input of the journal."""
        self.flight.entries.append(content)
        super().update(content)

    def rows(self, measurements: Sequence[Measurement], *, is_catch_up: bool = False) -> list[ChainRow]:
        """Take rows."""
        self.flight.entries.extend(measurements)
        return super().rows(measurements, is_catch_up=is_catch_up)


def main() -> int:
    """Record, write or compare; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    writers = commands.add_parser("record"), commands.add_parser("write")
    for each in writers:
        each.add_argument("directory", type=Path)
        each.add_argument("--scenario", action="append", default=[])
        each.add_argument("--seeds", type=int, default=10)
        each.add_argument("--jobs", type=int, default=2)
    writers[1].add_argument("--flights", type=Path, help="folder of recorded flights, in place of worlds")
    comparison = commands.add_parser("compare")
    comparison.add_argument("directory", type=Path)
    comparison.add_argument("other", type=Path)
    options = parser.parse_args()
    if options.command == "compare":
        return compare(options.directory, options.other)
    options.directory.mkdir(parents=True, exist_ok=True)
    is_recorded = options.command == "record"
    units = (
        flights_in(options.flights, options.directory)
        if not is_recorded and options.flights
        else [
            Unit(name, seed, method, options.directory)
            for name in options.scenario or (LOOPS if is_recorded else worlds())
            for seed in range(1, options.seeds + 1)
            for method in (Method.ROBUST, Method.PAPER)
        ]
    )
    suffix = ".flight" if is_recorded else ".parquet"
    left = [unit for unit in units if not unit.path.with_suffix(suffix).exists()]
    with ProcessPoolExecutor(options.jobs) as pool:
        for line in pool.map(record_unit if is_recorded else write_unit, left):
            print(line, flush=True)
    return 0


def worlds() -> list[str]:
    """Return the worlds of the study."""
    return list(dict.fromkeys(name for group in GROUPS.values() for name in group if name != SNAPSHOT))


def flights_in(folder: Path, directory: Path) -> list[Unit]:
    """Return the recorded flights of a folder, whose rows go to a directory."""
    units = []
    for path in sorted(folder.glob("*.flight")):
        name, seed, method = path.stem.rsplit("-", 2)
        units.append(Unit(name, int(seed), Method(method), directory, path))
    return units


def record_unit(unit: Unit) -> str:
    """Fly a closed loop, keep what its chain was given, and return a line about it."""
    chains: list[RecordedChain] = []

    def recorded(*given: Any, **named: Any) -> RecordedChain:
        chains.append(RecordedChain(*given, **named))
        return chains[0]

    with patch.object(run, "Chain", recorded):
        result = run.fly_unit(run.LoopUnit(unit.name, unit.seed, Sensing.AUTOMATIC, method=unit.method))
    if result.flight is None:
        return f"{unit.path.stem}: {result.refusal}"
    flight = chains[0].flight
    unit.path.with_suffix(".flight").write_bytes(pickle.dumps(flight))
    return f"{unit.path.stem}: {len(flight.entries)} entries"


def write_unit(unit: Unit) -> str:
    """Write the rows of a unit and return a line about them."""
    try:
        rows, plans = _of_world(unit) if unit.flight is None else _of_flight(unit.flight, unit.method)
    except UndrivenError as error:
        return f"{unit.path.stem}: {error}"
    table = joined_table(MeasurementColumns(list(plans.values()), plans.__getitem__))
    pages = (rows[first : first + PAGE_ROWS] for first in range(0, len(rows), PAGE_ROWS))
    unit.path.write_bytes(b"".join(table_bytes(table, "parquet", pages)))
    return f"{unit.path.stem}: {len(rows)} rows"


def _of_world(unit: Unit) -> tuple[list[JoinedRow], dict[int, tuple[str, ...]]]:
    """Return the rows of operation with the results of a method, which drives control, and the carriers of plans."""
    ground = simulated_world(unit.name, unit.seed).ground
    control = ControlSettings(unit.method, ControlMode.GROUND, Release.AUTOMATIC)
    opened = open_chain(replace(ground, spacecraft=replace(ground.spacecraft, control=control)))
    rows = [joined_row(each, opened.chain.step(each), unit.method) for each in opened.measurements(ground)]
    return rows, _carriers_of(opened.documents)


def _of_flight(path: Path, method: Method) -> tuple[list[JoinedRow], dict[int, tuple[str, ...]]]:
    """Return the rows of a recorded flight with the results of its method, and the carriers of plans."""
    flight: Flight = pickle.loads(path.read_bytes())  # noqa: S301 our own file
    chain, rows = Chain(flight.documents, ChainConfig(), methods=(method,)), []
    for entry in flight.entries:
        if isinstance(entry, Measurement):
            rows.append(joined_row(entry, chain.step(entry), method))
        else:
            chain.update(entry)
    return rows, _carriers_of(flight.documents)


def _carriers_of(documents: JournalDocuments) -> dict[int, tuple[str, ...]]:
    return {number: plan.carrier_ids for number, plan in documents.plans.items()}


def joined_row(measurement: Measurement, outcome: Outcome | None, method: Method) -> JoinedRow:
    """Return a measurement with what a method made of it."""
    rows = () if outcome is None else outcome.rows
    k = next((k for k, row in enumerate(rows) if row.method is method), None)
    if outcome is None or k is None:
        return JoinedRow(measurement, None, None, None)
    return JoinedRow(measurement, rows[k], outcome.carriers[k] if outcome.carriers else None, outcome.command)


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
