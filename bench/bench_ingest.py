"""Durable ingest through the whole HTTP stack, against the same endpoint without storage.

Run ``python -m bench.bench_ingest``. Servers run side by side, each a process of its own over a database of its own
(SQLite with ``synchronous=FULL``): the product, and one whose archive answers at once. They are loaded in turn, several
times, and the median of the ratios of neighbours counts. The product carries its journal consumer, as in operation, and
at the end its archive must hold every acknowledged row.

Batches of 100 rows tell what a backlog costs, single rows of 32 clients what many front ends at once do.
"""

import argparse
import asyncio
import os
import secrets
import statistics
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

from bench import options_of
from bench.load.http_load import Load, Rate, Shape
from bench.load.server_process import served
from service.client.service_client import ServiceClient
from service.records.storage import sqlite_url

BATCHES = Shape(rows=100, carriers=32, connections=8)
SINGLES = Shape(rows=1, carriers=32, connections=32)
#: durable batches a second over those without storage
GOAL_BATCHES = 0.35
#: values a second of batches, an aim
AIM_VALUES_PER_S = 150_000
#: durable single rows a second over those without storage
GOAL_SINGLES = 0.6
_WARM_UP_S = 0.5


class Middle(NamedTuple):
    """Medians of the repeats."""

    per_second: float
    p99_s: float


#: rates of each kind of archive, in the order in which they were measured
Rates = dict[str, list[Rate]]


def main() -> bool:
    """Print the figures and return whether the goals are met."""
    options = options_of(__doc__, repeats=5, seconds=1.5)
    with tempfile.TemporaryDirectory(dir=Path.cwd(), prefix="bench-") as name:

        def new_file(kind: str) -> str:
            """Return the URL of a new file."""
            return sqlite_url(f"{name}/{kind}-{secrets.token_hex(4)}.db")

        is_met = [_batches(new_file, options), _singles(new_file, options)]
    return all(is_met)


def _batches(new_url: Callable[[str], str], options: argparse.Namespace) -> bool:
    rates = measure(("none", "durable"), BATCHES, new_url, options)
    _report(BATCHES, rates)
    values_per_s = BATCHES.rows * BATCHES.carriers * _middle(rates["durable"]).per_second
    is_reached = values_per_s >= AIM_VALUES_PER_S
    print(f"  {values_per_s:.0f} values/s, aim {AIM_VALUES_PER_S}: {'reached' if is_reached else 'not reached'}")
    return _judge("durable over no storage", _ratio(rates), GOAL_BATCHES)


def _singles(new_url: Callable[[str], str], options: argparse.Namespace) -> bool:
    rates = measure(("none", "durable"), SINGLES, new_url, options)
    _report(SINGLES, rates)
    return _judge("durable over no storage", _ratio(rates), GOAL_SINGLES)


def measure(kinds: Sequence[str], shape: Shape, new_url: Callable[[str], str], options: argparse.Namespace) -> Rates:
    """Return the rates of interleaved measurements."""
    with ExitStack() as stack:
        loads = {kind: stack.enter_context(_served(kind, new_url(kind), shape)) for kind in kinds}
        for load in loads.values():
            asyncio.run(load.run(_WARM_UP_S))
        rates: Rates = {kind: [] for kind in kinds}
        for _ in range(options.repeats):
            for kind, load in loads.items():
                rates[kind].append(asyncio.run(load.run(options.seconds)))
        for kind, load in loads.items():
            if kind != "none":
                _check_stored(load)
    return rates


def _ratio(rates: Rates) -> float:
    """Return how many times as many requests the product answers: each pair was measured within seconds."""
    pairs = zip(rates["durable"], rates["none"], strict=True)
    return statistics.median(durable.per_second / rate.per_second for durable, rate in pairs)


def _middle(taken: Sequence[Rate]) -> Middle:
    return Middle(statistics.median(rate.per_second for rate in taken), statistics.median(rate.p99_s for rate in taken))


def _report(shape: Shape, rates: Rates) -> None:
    print(f"POST of {shape.rows} rows x {shape.carriers} carriers, {shape.connections} connections, ", end="")
    print(f"load of the machine {os.getloadavg()[0]:.1f}")
    for kind, taken in rates.items():
        middle = _middle(taken)
        rows_per_s = shape.rows * middle.per_second
        print(
            f"  {kind:8} {middle.per_second:7.0f} requests/s {rows_per_s:8.0f} rows/s, p99 {1e3 * middle.p99_s:6.1f} ms"
        )


def _judge(name: str, figure: float, goal: float) -> bool:
    """Print a figure beside its goal and return whether it is met."""
    is_met = figure >= goal
    print(f"  {name}: {figure:.2f}, goal >= {goal:.2f}: {'PASS' if is_met else 'MISS'}")
    return is_met


@contextmanager
def _served(kind: str, url_of_database: str, shape: Shape) -> Iterator[Load]:
    """Start a server with a carrier plan, give the load on it, and end it."""
    key = secrets.token_urlsafe(16)
    with served(kind, url_of_database, key) as process:
        yield Load(process.url, key, _add_plan(process.url, key, shape), shape)


def _add_plan(url: str, key: str, shape: Shape) -> int:
    """Store a spacecraft with a plan and return the plan's number."""
    carriers = [
        {
            "id": f"c{k:02d}",
            "station": {"name": f"s{k}", "latitude_deg": 45.0 + k / 2, "longitude_deg": 40.0 + 3 * k},
            "band": "C",
            "transponder": f"t{k // 2}",
            "uplink_hz": 6.0e9 + k * 1e7,
            "downlink_hz": 3.7e9 + k * 1e7,
            "bandwidth_hz": 5e6,
        }
        for k in range(shape.carriers)
    ]
    spacecraft = {
        "id": "bench",
        "name": "Bench",
        "longitude_deg": 90.0,
        "simulated": True,
        "receiving_site": {"name": "site", "latitude_deg": 55.0, "longitude_deg": 38.0, "height_m": 200.0},
        "inertia_kg_m2": [[4000, 0, 0], [0, 2000, 0], [0, 0, 4000]],
        "torque_limit_n_m": 0.05,
    }
    with ServiceClient(url, key, retries=6) as client:
        client.create_spacecraft(spacecraft)
        return int(client.put_carriers("bench", carriers)["plan_id"])


def _check_stored(load: Load) -> None:
    """Compare what was acknowledged with what the archive counts."""
    with ServiceClient(load.url, load.key) as client:
        stored = sum(source["rows"] for source in client.request("GET", "/spacecraft/bench/sources")["rows"])
    acknowledged = load.shape.rows * sum(load.sent)
    assert stored == acknowledged, f"{stored} rows stored of {acknowledged} acknowledged"


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
