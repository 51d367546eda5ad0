"""Durable ingest against the same endpoint without storage, through the whole HTTP stack.

Run ``python -m bench.bench_ingest``. Two servers run, one over a SQLite file with ``synchronous=FULL``, one whose
archive answers at once; they are loaded in turn, several times, and the median of the ratios of the pairs counts. The
durable one also carries its journal consumer, as in operation. At the end the archive must hold every acknowledged row.
"""

import argparse
import asyncio
import json
import os
import secrets
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from bench.http_load import Load, Rate, Shape
from service.client.service_client import ServiceClient

#: durable requests a second over those without storage
GOAL_RATIO = 1 / 3
_WARM_UP_S = 0.5


class IngestFigures(NamedTuple):
    """Medians of the repeats."""

    durable_per_s: float
    none_per_s: float
    durable_p99_s: float
    #: median over the pairs
    ratio: float


def main() -> bool:
    """Print the figures and return whether the goal is met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--rows", type=int, default=100)
    parser.add_argument("--carriers", type=int, default=32)
    parser.add_argument("--connections", type=int, default=8)
    options, _ = parser.parse_known_args()
    shape = Shape(options.rows, options.carriers, options.connections)
    figures = measure(shape, options.repeats, options.seconds)
    print(f"POST of {shape.rows} rows x {shape.carriers} carriers, {shape.connections} connections")
    print(f"  durable    {figures.durable_per_s:7.0f} requests/s {shape.rows * figures.durable_per_s:9.0f} rows/s")
    print(f"             p99 {1e3 * figures.durable_p99_s:.1f} ms")
    print(f"  no storage {figures.none_per_s:7.0f} requests/s")
    is_met = figures.ratio >= GOAL_RATIO
    print(f"  ratio {figures.ratio:.2f}, goal {GOAL_RATIO:.2f}: {'PASS' if is_met else 'MISS'}")
    return is_met


def measure(shape: Shape, repeats: int, seconds: float) -> IngestFigures:
    """Return the medians of interleaved measurements."""
    with tempfile.TemporaryDirectory(dir=Path.cwd(), prefix="bench-") as name:
        folder = Path(name)
        with _served("durable", folder, shape) as durable, _served("none", folder, shape) as none:
            rates: dict[str, list[Rate]] = {"durable": [], "none": []}
            for load in (durable, none):
                asyncio.run(load.run(_WARM_UP_S))
            for _ in range(repeats):
                rates["none"].append(asyncio.run(none.run(seconds)))
                rates["durable"].append(asyncio.run(durable.run(seconds)))
            _check_stored(durable)
    # each pair was measured one right after the other; the machine's load changes from pair to pair
    ratio = statistics.median(
        loaded.per_second / bare.per_second for loaded, bare in zip(rates["durable"], rates["none"], strict=True)
    )
    per_s = {kind: statistics.median(rate.per_second for rate in taken) for kind, taken in rates.items()}
    p99_s = statistics.median(rate.p99_s for rate in rates["durable"])
    return IngestFigures(per_s["durable"], per_s["none"], p99_s, ratio)


@contextmanager
def _served(kind: str, folder: Path, shape: Shape) -> Iterator[Load]:
    """Start a server with a carrier plan, give the load on it, and end it."""
    key = secrets.token_urlsafe(16)
    command = [sys.executable, "-m", "bench.ingest_server", "--archive", kind]
    command += ["--database", f"sqlite:///{folder / kind}.db"]
    environment = {**os.environ, "SOO_BOOTSTRAP_KEY": key, "OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as process:
        try:
            if process.stdout is None:
                raise RuntimeError("the server has no output")
            url = str(json.loads(process.stdout.readline())["url"])
            yield Load(url, key, _add_plan(url, key, shape), shape)
        finally:
            process.terminate()


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
