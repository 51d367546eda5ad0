"""Queries of an archive ten times as large: samples, the first status after a start, a stored row.

Run ``python -m bench.bench_summaries``; ``--rows`` of the larger archive, at a row a minute: 1 000 000 are two years
and take ten minutes to fill. Samples are asked for in an interval for a thousand rows of the larger archive: smaller
archives are asked as that one is for 1000. Each figure is a ratio of processor times of requests to the application,
asked in turn, medians of five.
"""

import argparse
import asyncio
import statistics
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import numpy as np

from bench import options_of
from bench.bench_storage import batch, outcome_of, prepare_catalogue
from db.encoding.segments import DAY_US
from db.storage import SqlStorage
from service.composition.bootstrap import build_app, build_maintenance
from service.composition.settings import Settings
from service.ports.archive import LIVE, ListPart, Outcome
from service.ports.storage import ClockReading
from service.records.calibration import (
    Alignment,
    CalibrationMethod,
    CalibrationRequest,
    CalibrationResult,
    Observability,
    Window,
)
from service.records.catalogue import Method, Spacecraft
from service.records.levels.attitude import NO_ANGLES, Axes
from service.records.levels.measurement import Measurement
from service.records.storage import sqlite_url

CARRIERS = 16
STEP_US = 60_000_000
START_US = 1_700_000_000_000_000 // DAY_US * DAY_US
#: what the time with ten times the rows may be, and attitude over powers
GOALS = {
    "samples, powers": 1.5,
    "samples, attitude": 1.5,
    "samples, carriers": 1.5,
    "status": 1.2,
    "append": 1.2,
    "outcome": 1.2,
}
GOAL_ATTITUDE = 1.5
#: processor time of a chart of the larger archive, s; a year of minutes with --rows 525600
GOAL_CHART_S = 0.4
_AT_ONCE = 7200
_INTERVAL_ROWS = 1000
_KEY = "key-of-the-benchmark"


class Times(NamedTuple):
    """Processor times of one archive by name, s; one value a repeat."""

    of: dict[str, list[float]]

    def median(self, name: str) -> float:
        """Return the median time."""
        return statistics.median(self.of[name])


class Tally(NamedTuple):
    """Numbers that are the judgement: time with ten times the rows over time with the rows, and between series."""

    ratios: dict[str, float]
    attitude_over_powers: float
    #: of the larger archive, by name
    chart_s: dict[str, float]


def main() -> bool:
    """Print the ratios and return whether the goals are met."""
    options = options_of(__doc__, rows=200_000, repeats=5)
    with tempfile.TemporaryDirectory(dir=Path.cwd(), prefix="bench-") as name:
        tally = measure(Path(name), options.rows, options.repeats)
    named = [(f"{key}, {options.rows} rows / a tenth", ratio, GOALS[key]) for key, ratio in tally.ratios.items()]
    is_met = True
    named.append(("samples, attitude / powers", tally.attitude_over_powers, GOAL_ATTITUDE))
    named += [(f"{name} of {options.rows} rows, s", taken_s, GOAL_CHART_S) for name, taken_s in tally.chart_s.items()]
    for what, figure, goal in named:
        is_met = is_met and figure <= goal
        print(f"  {what}: {figure:.2f}, goal <= {goal:g}: {'PASS' if figure <= goal else 'MISS'}")
    return is_met


def measure(folder: Path, rows: int, repeats: int) -> Tally:
    """Fill two archives and ask them in turn."""
    sizes = (rows // 10, rows)
    for size in sizes:
        fill(folder / f"{size}.db", size)
    times = {size: Times({}) for size in sizes}
    for repeat in range(repeats + 1):
        for size in sizes:
            found = asked(folder / f"{size}.db", size + repeat, rows // _INTERVAL_ROWS)
            # the first pass compiles and fills caches
            for name, taken_s in found.items() if repeat else ():
                times[size].of.setdefault(name, []).append(taken_s)
    for name in times[rows].of:
        print(f"  {name}: {', '.join(f'{1e3 * times[size].median(name):.1f} ms at {size}' for size in sizes)}")
    small, large = (times[size] for size in sizes)
    ratios = {name: large.median(name) / small.median(name) for name in large.of}
    chart_s = {name: large.median(name) for name in large.of if name.startswith("samples")}
    return Tally(ratios, large.median("samples, attitude") / large.median("samples, powers"), chart_s)


def fill(path: Path, rows: int) -> None:
    """Make an archive of rows a minute with robust results, sealed and summarised."""
    storage = SqlStorage(sqlite_url(str(path)))
    storage.prepare()
    plan_id = prepare_catalogue(storage, argparse.Namespace(carriers=CARRIERS))
    align(storage, plan_id)
    random = np.random.default_rng(1)
    for first in range(0, rows, _AT_ONCE):
        measured = append(storage, plan_id, first, min(_AT_ONCE, rows - first))
        results = [robust_of(row, random) for row in measured]
        storage.results.save_outcomes("bench", LIVE, results, measured[-1].number, measured[-1].epoch_us)
    settings = Settings.model_validate({"clock": "data"})
    app_clock = _Clock(START_US + (rows + 1440) * STEP_US)
    build_maintenance(settings, storage, app_clock).do_all()
    storage.close()


class _Clock:
    """A clock that stands."""

    def __init__(self, epoch_us: int) -> None:
        self._epoch_us = epoch_us

    def reading(self, _: Spacecraft, _newest_us: int | None) -> ClockReading:
        """Return the time of a spacecraft."""
        return ClockReading(is_data=False, now_us=self._epoch_us)

    def now_us(self, _: str) -> int:
        """Return the time of a spacecraft."""
        return self._epoch_us

    def system_us(self) -> int:
        """Return the time of the machine."""
        return self._epoch_us

    def is_data(self, _: str) -> bool:
        """Return that the time is the rows'."""
        return True


def align(storage: SqlStorage, plan_id: int) -> None:
    """Store a calibration and an alignment before every row."""
    window = Window(START_US - 20, START_US - 10)
    request = CalibrationRequest(window, window, CalibrationMethod.GEOMETRY)
    draft = storage.results.add_calibration("bench", request, plan_id, 1, 0, "bench")
    observability = Observability(1.0, Axes(1.0, 1.0, 1.0), Axes(0.1, 0.1, 0.1))
    storage.results.finish_calibration("bench", draft.id, CalibrationResult((), observability, {}, ()), None)
    storage.results.activate_calibration("bench", draft.id)
    zero = Axes(0.0, 0.0, 0.0)
    wanted = Alignment(0, START_US - 1, zero, NO_ANGLES, draft.id, "manual", 1, "bench", ())
    storage.results.add_alignment("bench", replace(wanted, calibration_by_method={"robust": draft.id}))


def append(storage: SqlStorage, plan_id: int, first: int, count: int) -> list[Measurement]:
    """Store some rows a minute and return them."""
    made = batch(plan_id, first, argparse.Namespace(carriers=CARRIERS, rows=count))
    epochs_us = START_US + (first + np.arange(count)) * STEP_US + 123_457
    made = replace(made, epochs_us=epochs_us, received_at_us=int(epochs_us[-1]) + 700_000)
    storage.archive.append_measurements(made).result()
    span = Window(int(epochs_us[0]), int(epochs_us[-1]) + 1)
    return storage.archive.measurements("bench", ListPart(span, count))


def robust_of(row: Measurement, random: np.random.Generator) -> Outcome:
    """Return the result of the robust method alone."""
    outcome = outcome_of(row, random, has_carriers=True)
    return Outcome(tuple(each for each in outcome.rows if each.method is Method.ROBUST), None)


def asked(path: Path, next_row: int, intervals: int) -> dict[str, float]:
    """Open an archive, ask everything once, store a row, and return the processor times."""
    storage = SqlStorage(sqlite_url(str(path)))
    settings = Settings.model_validate({"clock": "data", "bootstrap_key": _KEY})
    app = build_app(settings, storage)
    plan_id = storage.catalogue.plan("bench").id
    random = np.random.default_rng(2)
    times = asyncio.run(_answers(app, intervals))
    began = time.process_time()
    (row,) = append(storage, plan_id, next_row, 1)
    times["append"] = time.process_time() - began
    outcome = robust_of(row, random)
    began = time.process_time()
    storage.results.save_outcomes("bench", LIVE, [outcome], row.number, row.epoch_us)
    times["outcome"] = time.process_time() - began
    storage.close()
    return times


async def _answers(app: Any, intervals: int) -> dict[str, float]:
    """Return the processor time of each request."""
    times: dict[str, float] = {}
    transport = httpx.ASGITransport(app=app)
    robust = f"method=robust&count={intervals}"
    headers = {"Authorization": f"Bearer {_KEY}"}
    async with httpx.AsyncClient(transport=transport, base_url="http://bench", headers=headers, timeout=600) as client:
        for name, path in (
            ("status", "status"),
            ("samples, powers", f"samples?quantity=power_dbm&count={intervals}"),
            ("samples, attitude", f"samples?quantity=yaw_deg&{robust}&quantity=roll_deg&quantity=pitch_deg"),
            ("samples, carriers", f"samples?quantity=deviation_db&{robust}&quantity=residual_db"),
        ):
            began = time.process_time()
            answer = await client.get(f"/api/v1/spacecraft/bench/{path}")
            times[name] = time.process_time() - began
            assert answer.status_code == 200, answer.text
    return times


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
