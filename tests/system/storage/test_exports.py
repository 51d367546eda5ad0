"""Exported archives, imported again; clocks that step."""

import csv
import hashlib
import json
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import chaos_clients as chaos
import numpy as np
import pytest
import typer
from pyarrow import parquet
from typer.testing import CliRunner
from waiting import wait_until

from db.storage import SqlStorage
from service.api.export.export_files import OFFERED
from service.api.protocol.paging import EVERYTHING
from service.cli.importing.put_command import put
from service.ports.archive import LIVE, ListPart, Outcome
from service.records.catalogue import Carrier, Method, Site, Spacecraft
from service.records.levels.attitude import Axes, CarrierResults, TorqueCommand, row_without_attitude
from service.records.levels.measurement import Measurement, MeasurementBatch

pytestmark = pytest.mark.system


BASE = "/api/v1/spacecraft/sim-1/archive"
#: 2026-11-01T00:00:00Z
START_US = 1_793_491_200_000_000
STEP_US = 10_000_000
DAY_ROWS = 8640
INERTIA = ((2600.0, 0.0, 0.0), (0.0, 1400.0, 0.0), (0.0, 0.0, 2600.0))


def fill(database: Path, rows: int, carriers: int, *, with_results: bool = False) -> np.ndarray:
    """Store rows of random levels, ten seconds apart; return the levels."""
    storage = SqlStorage(f"sqlite:///{database}")
    storage.prepare()
    storage.catalogue.add_spacecraft(Spacecraft("sim-1", "Simulated", 90.0, Site(55.7, 37.6), INERTIA, 0.05))
    plan = storage.catalogue.put_plan(
        "sim-1", [Carrier(f"c{k:02d}", "Ku", "Ku1", 11.0e9 + k * 2e6, 1e6) for k in range(carriers)], "plan"
    )
    levels = np.random.default_rng(5).normal(-60.0, 5.0, (rows, carriers)).round(2).astype(np.float32)
    for first in range(0, rows, 5000):
        part = levels[first : first + 5000]
        batch = MeasurementBatch(
            "sim-1",
            "sa-1",
            plan.id,
            START_US + (first + len(part)) * STEP_US,
            np.arange(len(part)),
            START_US + (first + np.arange(len(part))) * STEP_US,
            part,
            (None,) * len(part),
            np.zeros(len(part), dtype=bool),
        )
        assert storage.archive.append_measurements(batch).result(120).accepted == len(part)
    if with_results:
        consume(storage)
    storage.close()
    return levels


def consume(storage: SqlStorage) -> None:
    """Store an attitude row, carrier results and a command of every measurement."""
    after = None
    while page := storage.archive.measurements("sim-1", ListPart(EVERYTHING, 2000, after)):
        after = (page[-1].epoch_us, page[-1].number)
        outcomes = []
        for row in page:
            attitude = row_without_attitude(
                row.epoch_us, row.received_at_us, row.number, Method.ROBUST, ("not_aligned",)
            )
            attitude = replace(attitude, attitude_deg=Axes(0.1, 0.2, row.power_dbm[0]))
            count = len(row.power_dbm)
            decibels = 0.004 * np.round(row.power_dbm)
            nothing = np.zeros(count, dtype=np.int64)
            carriers = CarrierResults(row.plan_id, decibels, decibels, nothing, nothing)
            outcomes.append(Outcome((attitude,), command_of(row), carriers=(carriers,)))
        storage.results.save_outcomes("sim-1", LIVE, outcomes, page[-1].number, page[-1].epoch_us)


def command_of(row: Measurement) -> TorqueCommand:
    """Return a command that follows from a measurement."""
    zero = Axes(0.0, 0.0, 0.0)
    return TorqueCommand(
        epoch_us=row.received_at_us,
        number=row.number,
        attitude_epoch_us=row.epoch_us,
        mode="ground",
        torque_n_m=Axes(0.0, -0.002, row.power_dbm[0]),
        wheels_n_m=(0.0,) * 3,
        saturated=False,
        command_period_s=10.0,
        valid_until_us=row.epoch_us + STEP_US,
        schedule=(),
        impulse_n_m_s=zero,
        predicted_angle_change_deg=zero,
        predicted_rate_change_deg_s=zero,
        predicted_wheel_momentum_n_m_s=(0.0,) * 3,
        control_allowed=True,
        inhibitions=(),
    )


def resident_mb(process: int) -> float:
    """Return the greatest resident memory of a process so far, MB."""
    text = Path(f"/proc/{process}/status").read_text()
    return int(next(line.split()[1] for line in text.splitlines() if line.startswith("VmHWM"))) / 1024


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory of a process is read from /proc")
def test_memory_of_an_export_does_not_grow_with_its_span(start_service: Any, tmp_path: Path) -> None:
    database = tmp_path / "soo.db"
    # more rows than a segment of TDM holds
    fill(database, 3 * DAY_ROWS, 16, with_results=True)
    service = start_service(database=database)
    grown = {}
    with service.client() as client:
        files = [("measurements", each) for each in OFFERED["measurements"]]
        files += [("joined", each) for each in OFFERED["joined"]]
        for series, file_format in files:
            short = {"format": file_format, "stop": "2026-11-02T00:00:00Z"}
            client.get(f"{BASE}/{series}:export", params=short, timeout=120).raise_for_status()
        for series, file_format in files:
            before, size = resident_mb(service.process.pid), 0
            asked = {"params": {"format": file_format}, "headers": {"Accept-Encoding": "identity"}, "timeout": 120}
            with client.stream("GET", f"{BASE}/{series}:export", **asked) as answer:
                for chunk in answer.iter_raw():
                    size += len(chunk)
            assert answer.status_code == 200
            grown[series, file_format] = resident_mb(service.process.pid) - before
            print(f"{series} {file_format}: {size / 1e6:.1f} MB, resident memory +{grown[series, file_format]:.1f} MB")
    # asked: 64 MB for any span
    assert max(grown.values()) <= 64.0, grown


def command(url: str, output: Path, *options: str, series: str = "measurements") -> list[str]:
    """Return the command that exports ten days."""
    span = ["--start", "2026-11-01T00:00:00Z", "--stop", "2026-11-11T00:00:00Z"]
    head = [sys.executable, "-m", "service", "export", "--spacecraft", "sim-1", "--series", series, *span]
    return [*head, "--service", url, "--output", str(output), "--json", *options]


@pytest.mark.slow
def test_an_interrupted_export_goes_on_and_every_format_is_the_archive(
    start_service: Any, tmp_path: Path, compiled_environment: dict[str, str]
) -> None:
    database = tmp_path / "soo.db"
    levels = fill(database, 3 * DAY_ROWS, 2)
    service = start_service(database=database)
    with service.client() as client:
        environment = compiled_environment | {"SOO_KEY": client.headers["Authorization"].partition(" ")[2]}

        def run(output: Path, *options: str, series: str = "measurements") -> dict[str, Any]:
            words = command(service.url, output, *options, series=series)
            done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=120)
            assert done.returncode == 0, done.stderr
            return dict(json.loads(done.stdout))

        output = tmp_path / "levels.csv"
        days = tmp_path / "levels.csv.days"
        # a machine that lets this test wait may have finished the export before the kill
        while output.exists() or not days.exists():
            output.unlink(missing_ok=True)
            shutil.rmtree(days, ignore_errors=True)
            process = subprocess.Popen(command(service.url, output), env=environment, stdout=subprocess.DEVNULL)
            kill_after_first(days, process)
        # a day that was cut off goes on, one that was spoilt is taken again
        first = sorted(days.glob("*.csv"))[0]
        whole = first.read_bytes()
        first.with_name(first.name + ".part").write_bytes(whole[:1000])
        first.unlink()
        report = run(output)
        assert (report["rows"], report["days"]) == (3 * DAY_ROWS, 3)
        assert not days.exists()
        streamed = client.get(f"{BASE}/measurements:export", timeout=120).content
        assert output.read_bytes() == streamed
        assert report["sha256"] == hashlib.sha256(streamed).hexdigest()
        rows = list(csv.reader(streamed.decode().splitlines()))[1:]
        assert np.array_equal(np.array([row[2:] for row in rows], dtype=np.float32), levels)

        table_path = tmp_path / "levels.parquet"
        assert run(table_path, "--format", "parquet")["rows"] == len(levels)
        table = parquet.read_table(table_path)
        columns = [table.column(f"c{k:02d}_dbm").to_numpy() for k in range(2)]
        assert np.array_equal(np.stack(columns, axis=1), levels)

        both = tmp_path / "joined.csv"
        assert run(both, series="joined")["rows"] == len(levels)
        assert both.read_bytes() == client.get(f"{BASE}/joined:export", timeout=120).content
        heads = [line.split(b",")[:4] for line in both.read_bytes().splitlines()]
        assert heads == [line.split(b",") for line in streamed.splitlines()]

        folder = tmp_path / "by-day"
        kept = run(folder, "--format", "ndjson", "--by-day")
        assert sorted(path.name for path in folder.iterdir()) == [
            f"measurements_2026-11-0{day}.ndjson" for day in (1, 2, 3)
        ]
        assert kept["bytes"] == sum(path.stat().st_size for path in folder.iterdir())
        spoilt = folder / "measurements_2026-11-02.ndjson"
        good = spoilt.read_bytes()
        spoilt.write_bytes(good[:-1] + b"!")
        run(folder, "--format", "ndjson", "--by-day")
        assert spoilt.read_bytes() == good


def kill_after_first(folder: Path, process: "subprocess.Popen[bytes]") -> None:
    """Kill an export when its first day is there."""
    wait_until(lambda: list(folder.glob("*.csv")) or process.poll() is not None, "the first day")
    process.kill()
    process.wait(120)


SPAN = {"start": "2026-11-01T00:00:00Z", "stop": "2026-11-02T00:00:00Z"}
ROWS = 500
SEED = 11


@pytest.mark.slow
def test_every_format_goes_round(
    start_service: Any,
    spacecraft: dict[str, Any],
    carriers: list[dict[str, Any]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    service = start_service()
    with service.client() as client:
        monkeypatch.setenv("SOO_KEY", client.headers["Authorization"].partition(" ")[2])
        for name in ("sim-1", "sim-csv", "sim-ndjson", "sim-parquet", "sim-tdm"):
            client.post("/api/v1/spacecraft", json={**spacecraft, "id": name}).raise_for_status()
            plan = client.put(f"/api/v1/spacecraft/{name}/carriers", json={"carriers": carriers})
            plan.raise_for_status()
        levels = rng.uniform(-120.0, 5.0, (ROWS, len(carriers))).astype(np.float32)
        rows = [
            {
                "epoch": f"2026-11-01T00:{k // 60:02d}:{k % 60:02d}.{k:06d}Z",
                "power_dbm": [None if rng.random() < 0.1 else float(level) for level in row],
            }
            for k, row in enumerate(levels)
        ]
        url = "/api/v1/spacecraft/sim-1/measurements:batch"
        sent = client.post(url, json={"plan_id": 1, "source": "sa-1", "measurements": rows})
        assert sent.json()["accepted"] == ROWS
        for file_format in ("csv", "ndjson", "parquet", "tdm"):
            path = tmp_path / f"levels.{file_format}"
            wanted = exported(client, "sim-1", file_format)
            path.write_bytes(wanted)
            assert send_rows(path, f"sim-{file_format}", service.url) == ROWS
            again = exported(client, f"sim-{file_format}", file_format)
            assert data_of(file_format, again) == data_of(file_format, wanted)
            # and the same levels whatever way they went
            assert exported(client, f"sim-{file_format}", "csv") == exported(client, "sim-1", "csv")


def send_rows(path: Path, spacecraft_id: str, url: str) -> int:
    """Send a file with the command and return how many rows were new."""
    app = typer.Typer()
    app.command()(put)
    before = signal.getsignal(signal.SIGTERM)
    try:
        given = ["powers", str(path), "--spacecraft", spacecraft_id, "--source", "sa-1", "--service", url, "--json"]
        done = CliRunner().invoke(app, given)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert done.exit_code == 0, done.output
    return int(json.loads(done.stdout)["accepted"])


def exported(client: Any, spacecraft_id: str, file_format: str) -> bytes:
    """Return the export of the day."""
    url = f"/api/v1/spacecraft/{spacecraft_id}/archive/measurements:export"
    answer = client.get(url, params={**SPAN, "format": file_format})
    assert answer.status_code == 200, answer.text
    return bytes(answer.content)


def data_of(file_format: str, content: bytes) -> bytes:
    """Return a file without the id of its message, which names the spacecraft."""
    if file_format != "tdm":
        return content
    return b"\n".join(line for line in content.splitlines() if not line.startswith(b"MESSAGE_ID"))


CLOCK_BASE = "/api/v1/spacecraft"
HOUR_US = 3_600_000_000
#: time.time_ns() of the one module that reads it, moved by what stands in a file
STEPPED = """
import pathlib, time
import service.runtime.clock as clock
class Stepped:
    time_ns = staticmethod(lambda: time.time_ns() + 1000 * int(pathlib.Path({path!r}).read_text()))
clock.time = Stepped
"""


class Bench:
    """A service whose clock can be set, and rows to send it."""

    def __init__(self, client, plan_id, offset, chaos):
        self.client, self._plan_id, self._offset, self._chaos = client, plan_id, offset, chaos
        self._position = 0

    def step(self, hours):
        """Set the clock so many hours off."""
        fresh = self._offset.with_suffix(".new")
        fresh.write_text(str(hours * HOUR_US))
        fresh.replace(self._offset)

    def send(self, hours=0):
        """Send five rows of the last second, on a clock so many hours off; return what was said of them."""
        now_us = time.time_ns() // 1000 + hours * HOUR_US
        self._position += 10
        return self.post([self._chaos.text_of(now_us - 1_000_000 + 10 * k + self._position) for k in range(5)])

    def post(self, epochs):
        """Send rows that differ from one another; return accepted, late and codes of refusals."""
        rows = [{"epoch": epoch, "power_dbm": [-50.0 - position] * 16} for position, epoch in enumerate(epochs)]
        body = {"plan_id": self._plan_id, "source": "sa-1", "measurements": rows}
        answer = self.client.post(f"{CLOCK_BASE}/sim-1/measurements:batch", json=body)
        assert answer.status_code == 200, answer.text
        said = answer.json()
        assert said["received"] == said["accepted"] + said["duplicates"] + len(said["refused"])
        return said["accepted"], said["late"], sorted({refusal["code"] for refusal in said["refused"]})

    def stored(self, **window):
        """Return the epochs of the history."""
        window = window or {"start": "2016-01-01T00:00:00Z", "stop": "2099-01-01T00:00:00Z"}
        answer = self.client.get(f"{CLOCK_BASE}/sim-1/measurements/history", params={**window, "limit": 1000})
        return [row["epoch"] for row in answer.json()["rows"]]


@pytest.fixture
def bench(start_service, spacecraft, carriers, tmp_path):
    """A service under the system's clock, which is right at first."""
    offset = tmp_path / "offset"
    offset.write_text("0")
    (tmp_path / "sitecustomize.py").write_text(STEPPED.format(path=str(offset)))
    environment = {"SOO_BOOTSTRAP_KEY": "a-key-for-tests-only", "PYTHONPATH": str(tmp_path)}
    service = start_service("--port", "0", "--clock", "system", environment=environment)
    with service.client() as client:
        plan_id = chaos.set_up(client, {**spacecraft, "simulated": False}, carriers)
        yield Bench(client, plan_id, offset, chaos)
    assert service.end()[0] == 0
    assert "Traceback" not in service.written()


@pytest.mark.slow
def test_steps_of_an_hour_and_a_leap_second_cost_no_row(bench):
    assert bench.send() == (5, 0, [])
    bench.step(+1)
    # rows of the right time are an hour old now; the archive keeps them, the estimator does not follow them
    assert bench.send() == (5, 5, [])
    assert bench.send(hours=1) == (5, 0, [])
    bench.step(0)
    # behind what the chain has consumed
    wait_until(lambda: not bench.client.get(f"{CLOCK_BASE}/sim-1/status").json()["pending"], "rows are consumed")
    accepted, late, codes = bench.send()
    assert (accepted, codes) == (5, [])
    assert late in (0, 5)
    bench.step(-1)
    assert bench.send() == (0, 0, ["time.future"])
    assert bench.send(hours=-1)[0] == 5
    bench.step(0)
    assert bench.send()[0] == 5
    epochs = bench.stored()
    assert len(epochs) == len(set(epochs)) == 30
    assert bench.client.get("/readyz").status_code == 200
    # 23:59:60.x stands at 00:00:00.x and gives way by 1 us, for a single row and in a batch of the fast form alike
    second = [f"2016-12-31T23:59:{text}Z" for text in ("59.500000", "60.000000", "60.500000")]
    minute = [f"2017-01-01T00:00:{text}Z" for text in ("00.000000", "00.500000")]
    others = [f"2017-01-01T00:00:{position:02d}.000000Z" for position in range(1, 8)]
    assert bench.post([*second, *minute]) == (5, 5, [])
    assert bench.post([*second[1:2], *others])[0] == 7
    window = {"start": "2016-12-31T23:59:59Z", "stop": "2017-01-01T00:00:08Z"}
    moved = [f"2017-01-01T00:00:00.{text}Z" for text in ("000001", "500001")]
    assert bench.stored(**window) == sorted([second[0], *minute, *moved, *others])
