"""Bytes of a row and rate of reading: days of rows in batches of 100 of 32 carriers, and their results.

Run ``python -m bench.bench_storage``; ``--help`` tells the options. Days of one source are read into arrays as rows,
sealed, and read again, for each kind of levels: of carriers spread over 20 dB, in hundredths and thousandths of a
decibel as analyzers tell them, in five decimals and with flags as the front end sends them, and with every bit of a
float32. At last come the rows of results. ``--url`` takes an empty database of a PostgreSQL server for each kind, with
``{}`` for their numbers from 0 on.
"""

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from db.encoding.segments import DAY_US, SegmentCache
from db.storage import SqlStorage
from service.ports.archive import LIVE, Outcome
from service.records.calibration import Window
from service.records.catalogue import LIVE_METHODS, Carrier, Method, Site, Spacecraft
from service.records.levels.attitude import NO_ANGLES, AttitudeRow, Axes, CarrierResults, Pulse, Status, TorqueCommand
from service.records.levels.measurement import Measurement, MeasurementBatch
from service.records.storage import sqlite_url

START_US = 1_795_000_000_000_000
#: rows of one day at a row every ten seconds
DAY_ROWS = 8640
#: bytes of a row over those of its powers as float32: in the table of rows, in sealed days of two decimals
GOAL_HOT, GOAL_HOT_SERVER, GOAL_SEALED = 1.75, 2.5, 0.35
#: rows a second read from sealed days over those read as rows
GOAL_READ = 2.5
#: bytes of all sealed results of a measurement: attitude of two methods and a torque command
GOAL_RESULTS = 290.0
#: the same with the results of 16 carriers
GOAL_CARRIERS = 400.0
#: rows of one day at a row a minute, and bytes of a row of 16 carriers then, summaries included: powers, results
MINUTES = 1440
GOAL_MINUTE_POWERS, GOAL_MINUTE_RESULTS = 42.0, 360.0
#: decimals of levels, None = as they come
KINDS: dict[str, int | None] = {"0.01 dB": 2, "0.001 dB": 3, "front end": 5, "all bits": None}


def main() -> bool:
    """Print bytes a row and rows a second; return whether the goals are met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=100)
    parser.add_argument("--carriers", type=int, default=32)
    parser.add_argument("--days", type=int, default=4, help="days of 8640 rows to read as rows and sealed")
    parser.add_argument("--url", help="empty databases to measure instead of a SQLite file")
    options, _ = parser.parse_known_args()
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as name:
        folder = Path(name)
        urls = {kind: sqlite_url(f"{folder / str(position)}.db") for position, kind in enumerate(KINDS)}
        if options.url:
            urls = {kind: options.url.format(position) for position, kind in enumerate(KINDS)}
        is_met = [measure_reading(url, kind, options) for kind, url in urls.items()]
        options.carriers = 16
        is_met.append(measure_minutes(sqlite_url(f"{folder / 'minutes'}.db"), options))
        for has_carriers in (False, True):
            url = sqlite_url(f"{folder / 'results'}{has_carriers:d}.db")
            is_met.append(measure_results(url, options, has_carriers=has_carriers))
    return all(is_met)


def measure_reading(url: str, kind: str, options: argparse.Namespace) -> bool:
    """Print bytes a row and rows a second read into arrays, as rows and sealed; return whether the goals are met."""
    storage = SqlStorage(url)
    storage.prepare()
    plan_id = prepare_catalogue(storage, options)
    rows = send_days(storage, plan_id, kind, options)
    by_rows = read_rate(storage, rows)
    payload = 4 * options.carriers * rows
    hot = size_of_rows(storage) / payload
    started = time.perf_counter()
    sealed = sum(part.rows for part in storage.archive.seal("bench", 1 << 60, 1 << 60))
    sealing_s = time.perf_counter() - started
    assert sealed == rows, f"{sealed} rows sealed of {rows}"
    by_segments = read_rate(storage, rows)
    packed = size_of_segments(storage) / payload
    storage.close()
    print(
        f"levels {kind}: read {by_rows:.0f} rows/s as rows, {by_segments:.0f} sealed; sealed at {rows / sealing_s:.0f}"
    )
    goal = GOAL_HOT if url.startswith("sqlite") else GOAL_HOT_SERVER
    judged = [judge("hot over powers", hot, goal, f"{hot * 4 * options.carriers:.0f} B a row")]
    of_sealed = f"{packed * 4 * options.carriers:.0f} B a row"
    if kind == "0.01 dB":
        judged.append(judge("sealed over powers", packed, GOAL_SEALED, of_sealed))
    else:
        print(f"  sealed over powers {packed:.2f} ({of_sealed})")
    judged.append(judge("read sealed over rows", by_segments / by_rows, GOAL_READ, "times", is_least=True))
    return all(judged)


def send_days(storage: SqlStorage, plan_id: int, kind: str, options: argparse.Namespace) -> int:
    """Store whole days of one front end and return how many rows; those of the front end have all that it sends."""
    first_us = START_US // DAY_US * DAY_US
    day_rows = getattr(options, "day_rows", DAY_ROWS)
    rows: int = options.days * day_rows // options.rows * options.rows
    zeros = ((0,) * options.carriers,) * options.rows
    for start in range(0, rows, options.rows):
        epochs_us = first_us + (start + np.arange(options.rows)) * (DAY_US // day_rows)
        made = batch(plan_id, start, options, KINDS[kind])
        made = replace(made, epochs_us=epochs_us, received_at_us=int(epochs_us[-1]) + 700_000, first_seq=start)
        if kind == "front end":
            made = replace(made, flags=zeros)
        storage.archive.append_measurements(made).result()
    return rows


def measure_minutes(url: str, options: argparse.Namespace) -> bool:
    """Print bytes of a sealed row at a row a minute, summaries included; return whether the goals are met."""
    storage = SqlStorage(url)
    storage.prepare()
    plan_id = prepare_catalogue(storage, options)
    measured = measured_days(storage, plan_id, options, days=4, day_rows=MINUTES)
    assert sum(part.rows for part in storage.archive.seal("bench", 1 << 60, 1 << 60)) == len(measured)
    powers = size_of_segments(storage) + size_of_summaries(storage)
    store_results(storage, measured, options, has_carriers=True)
    assert sum(part.rows for part in storage.results.seal("bench", 1 << 60)) == 3 * len(measured)
    results = size_of_segments(storage) + size_of_summaries(storage) - powers
    storage.close()
    print("sealed at a row a minute, summaries included, 16 carriers:")
    is_small = judge("powers", powers / len(measured), GOAL_MINUTE_POWERS, "B")
    return judge("results of a measurement", results / len(measured), GOAL_MINUTE_RESULTS, "B") and is_small


def measured_days(
    storage: SqlStorage, plan_id: int, options: argparse.Namespace, *, days: int, day_rows: int
) -> list[Measurement]:
    """Store days of powers of two decimals and return them."""
    chosen = {**vars(options), "days": days, "day_rows": day_rows}
    send_days(storage, plan_id, "0.01 dB", argparse.Namespace(**chosen))
    entries = storage.archive.journal("bench", 0, 1 << 30)
    return [entry.content for entry in entries if isinstance(entry.content, Measurement)]


def store_results(
    storage: SqlStorage, measured: list[Measurement], options: argparse.Namespace, *, has_carriers: bool
) -> None:
    """Store results of measurements of two methods and a torque command."""
    random = np.random.default_rng(1)
    for start in range(0, len(measured), options.rows):
        outcomes = [
            outcome_of(row, random, has_carriers=has_carriers) for row in measured[start : start + options.rows]
        ]
        storage.results.save_outcomes("bench", LIVE, outcomes, measured[start].number, measured[start].epoch_us)


def measure_results(url: str, options: argparse.Namespace, *, has_carriers: bool) -> bool:
    """Print bytes a row of attitude, two methods a measurement, and of torques; return whether the goal is met."""
    storage = SqlStorage(url)
    storage.prepare()
    plan_id = prepare_catalogue(storage, options)
    measured = measured_days(storage, plan_id, options, days=1, day_rows=DAY_ROWS)
    store_results(storage, measured, options, has_carriers=has_carriers)
    attitude = _size(storage, "attitude", "attitude_sequence") / (2 * len(measured))
    torque = _size(storage, "torque", "torque_sequence") / len(measured)
    started = time.process_time()
    sealed = sum(part.rows for part in storage.results.seal("bench", 1 << 60))
    sealing_s = time.process_time() - started
    assert sealed == 3 * len(measured), f"{sealed} results sealed of {3 * len(measured)}"
    segments, summaries = (size(storage) / len(measured) for size in (size_of_segments, size_of_summaries))
    storage.close()
    print(f"results: {attitude:.0f} B a row of attitude (two a measurement), {torque:.0f} B a torque command")
    print(f"  sealed at {sealed / sealing_s:.0f} rows a second of processor time")
    of_carriers = f"with {options.carriers} carriers" if has_carriers else "without carriers"
    goal = GOAL_CARRIERS if has_carriers else GOAL_RESULTS
    print(f"  {summaries:.0f} B more for their summaries, at a row in ten seconds: minutes of six rows")
    return judge(f"sealed results of a measurement, {of_carriers}", segments, goal, "B")


def outcome_of(row: Measurement, random: np.random.Generator, *, has_carriers: bool) -> Outcome:
    """Return results with all bits in use, as a calm day gives them."""
    rows = []
    for method in LIVE_METHODS:
        angles, sigma, rates = (Axes(*random.normal(0.0, 0.05, 3).tolist()) for _ in range(3))
        figures, protection = random.normal(0.0, 0.1, 2).tolist(), Axes(*random.normal(0.0, 0.1, 3).tolist())
        rows.append(
            AttitudeRow(
                epoch_us=row.epoch_us,
                received_at_us=row.received_at_us,
                number=row.number,
                method=method,
                attitude_deg=angles,
                sigma_deg=sigma,
                rates_deg_s=rates if method is Method.ROBUST else None,
                status=Status.ACQUIRED,
                control_allowed=True,
                control_allowed_axes=(True, True, True),
                inhibitions=(),
                carriers_used=32,
                excluded=(),
                downlink_fade=False,
                downlink_fade_db=0.0,
                common_db=figures[0],
                residual_rms_db=figures[1],
                calibration_id=1,
                alignment_id=1,
                protection_deg=protection if method is Method.ROBUST else NO_ANGLES,
            )
        )
    carriers = tuple(carriers_of(row, random) for _ in rows) if has_carriers else ()
    return Outcome(tuple(rows), command_of(row, random), carriers=carriers)


def carriers_of(row: Measurement, random: np.random.Generator) -> CarrierResults:
    """Return results of carriers of a calm day: noise of 0.1 dB, one of 16 left out now and then."""
    count = len(row.power_dbm)
    levels_db = random.normal(0.0, 0.1, (2, count))
    state = np.where(random.random(count) < 1 / 256, 2, 0)
    return CarrierResults(row.plan_id, levels_db[0], levels_db[1], state, np.ones(count, dtype=np.int64))


def command_of(row: Measurement, random: np.random.Generator) -> TorqueCommand:
    """Return a command of one element."""
    torque, impulse, angles, rates = (Axes(*random.normal(0.0, 0.01, 3).tolist()) for _ in range(4))
    return TorqueCommand(
        epoch_us=row.epoch_us,
        number=row.number,
        attitude_epoch_us=row.epoch_us,
        mode="ground",
        torque_n_m=torque,
        wheels_n_m=torque,
        saturated=False,
        command_period_s=60.0,
        valid_until_us=row.epoch_us + 60_000_000,
        schedule=(Pulse(row.epoch_us, 2.5, torque),),
        impulse_n_m_s=impulse,
        predicted_angle_change_deg=angles,
        predicted_rate_change_deg_s=rates,
        predicted_wheel_momentum_n_m_s=impulse,
        control_allowed=True,
        inhibitions=(),
    )


def judge(name: str, figure: float, goal: float, unit: str, *, is_least: bool = False) -> bool:
    """Print a figure beside its goal and return whether it is met."""
    is_met = figure >= goal if is_least else figure <= goal
    sign = ">=" if is_least else "<="
    print(f"  {name} {figure:.2f} ({unit}), goal {sign} {goal:.2f}: {'PASS' if is_met else 'MISS'}")
    return is_met


def read_rate(storage: SqlStorage, rows: int) -> float:
    """Return rows a second read into arrays, median of five passes that remember nothing of each other."""
    rates = []
    for _ in range(5):
        storage._database.segments = SegmentCache()  # noqa: SLF001 - what was read lately must not help
        started = time.perf_counter()
        read = sum(len(block.epochs_us) for block in storage.archive.measurement_blocks("bench", Window(0, 1 << 60)))
        rates.append(read / (time.perf_counter() - started))
        assert read == rows, f"{read} rows read of {rows}"
    return float(np.median(rates))


def size_of_rows(storage: SqlStorage) -> int:
    """Return the bytes of the table of rows with its indexes."""
    return _size(storage, "measurement", "measurement_number")


def size_of_segments(storage: SqlStorage) -> int:
    """Return the bytes of the table of segments with its indexes."""
    return _size(storage, "segment", "segment_number", "segment_sequence", "sqlite_autoindex_segment_1")


def size_of_summaries(storage: SqlStorage) -> int:
    """Return the bytes of the table of summaries with its index."""
    return _size(storage, "summary", "sqlite_autoindex_summary_1")


def _size(storage: SqlStorage, *names: str) -> int:
    with storage._database.engines.write.connect() as connection:  # noqa: SLF001 - no port tells sizes of tables
        if connection.dialect.name == "postgresql":
            return int(connection.exec_driver_sql("SELECT pg_total_relation_size(%s)", (names[0],)).scalar_one())
        marks = ", ".join("?" * len(names))
        query = f"SELECT sum(pgsize) FROM dbstat WHERE name IN ({marks})"  # noqa: S608 - marks only
        return int(connection.exec_driver_sql(query, names).scalar_one())


def prepare_catalogue(storage: SqlStorage, options: argparse.Namespace) -> int:
    """Store a spacecraft with a plan and return the plan's id."""
    inertia = ((4000.0, 0.0, 0.0), (0.0, 2000.0, 0.0), (0.0, 0.0, 4000.0))
    storage.catalogue.add_spacecraft(Spacecraft("bench", "Bench", 90.0, Site(55.0, 38.0), inertia, 0.05))
    carriers = [Carrier(f"c{k:02}", "C", f"t{k // 2}", 3.7e9 + k * 1e7, 5e6) for k in range(options.carriers)]
    return storage.catalogue.put_plan("bench", carriers, "bench").id


def batch(plan_id: int, seed: int, options: argparse.Namespace, decimals: int | None = 2) -> MeasurementBatch:
    """Return a batch of one front end: carriers spread over 20 dB, each with noise of 0.1 dB."""
    rows = options.rows
    random = np.random.default_rng(seed)
    levels = np.linspace(-70.0, -50.0, options.carriers) + random.normal(0.0, 0.1, (rows, options.carriers))
    return MeasurementBatch(
        spacecraft_id="bench",
        source="sa-0",
        plan_id=plan_id,
        received_at_us=START_US,
        index=np.arange(rows),
        epochs_us=np.arange(rows),
        power_dbm=(levels if decimals is None else np.round(levels, decimals)).astype(np.float32),
        flags=(None,) * rows,
        is_stale=np.zeros(rows, dtype=bool),
        first_seq=0,
    )


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
