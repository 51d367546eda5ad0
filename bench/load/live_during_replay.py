"""Time from the post of a live row to its estimate, beside a replay and without one.

Run ``python -m bench.load.live_during_replay``. One service on a file estimates rows posted one by one, alone and
while it replays all that it holds (``--rows``, a row a minute) in its worker process; both in turn. The judgement is
the ratio of the times that nine rows in ten stay below. Client, service and replay want three processors: with two the
ratio says what priorities leave to live rows.
"""

import argparse
import statistics
import sys
import tempfile
import time
from pathlib import Path

from bench.bench_operation import Operated, at, await_consumed, await_estimate, fill, next_minute, operated, post_row
from service.records.epoch import format_epoch
from tests.fakes.drivers.busy_station import SC

GOAL = 1.2


def main() -> bool:
    """Print the ratio and return whether the goal is met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=20_000)
    parser.add_argument("--live", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=3)
    options, _ = parser.parse_known_args()
    with tempfile.TemporaryDirectory(dir=Path.cwd(), prefix="bench-") as name:
        fill(Path(name), options.rows)
        database = Path(name) / "soo.db"
        with operated(database) as service:
            await_consumed(database)
            ratio = statistics.median(pair(service, database, options.live) for _ in range(options.repeats))
    print(
        f"live row beside a replay over alone, p90: {ratio:.2f}, goal {GOAL:g}: {'PASS' if ratio <= GOAL else 'MISS'}"
    )
    return ratio <= GOAL


def pair(service: Operated, database: Path, live: int) -> float:
    """Return the 90 % time of rows beside a replay over that of rows alone, printed as it is measured."""
    minute = next_minute(database)
    alone_s = p90_s(service, minute, live)
    started = service.post("replays", {"start": format_epoch(at(1)), "stop": format_epoch(at(minute))})
    while (job := service.client.get(f"/api/v1/jobs/{started['job']}").json())["progress"] == 0.0:
        assert job["state"] in ("queued", "running"), job
        time.sleep(0.05)
    during_s = p90_s(service, minute + live, live)
    state = service.client.get(f"/api/v1/jobs/{started['job']}").json()["state"]
    assert state == "running", f"the replay is {state}: ask for more --rows"
    answer = service.client.delete(f"/api/v1/spacecraft/{SC}/replays/{started['id']}")
    assert answer.is_success, answer.text
    print(
        f"  90 % of {live} rows below {1e3 * alone_s:.0f} ms alone, {1e3 * during_s:.0f} ms beside a replay", flush=True
    )
    return during_s / alone_s


def p90_s(service: Operated, first: int, count: int) -> float:
    """Return the time that nine rows in ten take until their estimate is answered, s."""
    taken_s = []
    for minute in range(first, first + count):
        began_s = time.perf_counter()
        await_estimate(service, post_row(service, minute), 0.002)
        taken_s.append(time.perf_counter() - began_s)
    return statistics.quantiles(taken_s, n=10)[-1]


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
