"""``soo put powers`` as a process against a service as a process: killed it goes on, nothing is doubled."""

import json
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import chaos_clients as chaos
import pytest
import typer
from typer.testing import CliRunner

from service.cli.importing.put_command import put

pytestmark = pytest.mark.system

SEED = 5
ROWS = 4000
#: of a request that may be interrupted: a whole file of them takes some seconds more than the way to its interruption
PART_ROWS = 5
BASE = "/api/v1/spacecraft"
EVERYTHING = {"start": "2000-01-01T00:00:00Z", "stop": "2100-01-01T00:00:00Z"}


def epoch(number: int) -> str:
    """Return the epoch of a row, ten a second."""
    seconds, tenths = divmod(number, 10)
    return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(1_767_225_600 + seconds)) + f".{tenths}00000Z"


def write(path: Path, carriers: list[str]) -> list[str]:
    """Write an archive of random levels; return its lines as the service exports them."""
    draw = random.Random(SEED)
    header = ",".join(("epoch", "source", *(f"{name}_dbm" for name in carriers)))
    lines = [
        ",".join(
            (epoch(k), "sa-9", *("" if draw.random() < 0.02 else f"{-draw.uniform(40, 60):.2f}" for _ in carriers))
        )
        for k in range(ROWS)
    ]
    path.write_text("\n".join((header, *lines)) + "\n")
    return [header, *lines]


def command(path: Path, url: str, *options: str) -> list[str]:
    """Return the command that sends a file."""
    head = [sys.executable, "-m", "service", "put", "powers", str(path), "--spacecraft", "sim-1", "--source", "sa-9"]
    return [*head, "--service", url, "--json", *options]


@pytest.mark.slow
def test_an_export_sent_through_kills_is_exported_the_same(
    start_service: Any,
    spacecraft: dict[str, Any],
    carriers: list[dict[str, Any]],
    tmp_path: Path,
    compiled_environment: dict[str, str],
) -> None:
    print(f"seed {SEED}")
    service = start_service()
    with service.client() as client:
        chaos.set_up(client, spacecraft, carriers)
        environment = compiled_environment | {"SOO_KEY": client.headers["Authorization"].partition(" ")[2]}
        path = tmp_path / "levels.csv"
        wanted = write(path, [each["id"] for each in carriers])

        def run(*options: str) -> tuple[int, dict[str, Any]]:
            done = subprocess.run(
                command(path, service.url, *options), env=environment, capture_output=True, text=True, timeout=120
            )
            return done.returncode, json.loads(done.stdout or "{}")

        code, checked = run("--dry-run")
        assert (code, checked["rows"], checked["start"], checked["stop"]) == (0, ROWS, epoch(0), epoch(ROWS - 1))
        draw = random.Random(SEED)
        for stop in (signal.SIGKILL, signal.SIGTERM, signal.SIGKILL):
            process = subprocess.Popen(
                command(path, service.url, "--batch-rows", str(PART_ROWS)),
                env=environment,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            before = rows_of(client)
            while rows_of(client) < before + 100 and process.poll() is None:
                time.sleep(0.005)
            time.sleep(draw.uniform(0.0, 0.1))
            process.send_signal(stop)
            assert process.wait(120) in {-signal.SIGKILL, 1}
        interrupted = rows_of(client)
        assert 300 <= interrupted < ROWS
        code, report = run()
        assert code == 0
        assert interrupted - PART_ROWS <= report["resumed_at"] <= interrupted
        assert report["accepted"] + report["duplicates"] == report["rows"] == ROWS
        # what a kill cut off after the commit was known again: one request a kill at most
        assert report["duplicates"] <= 3 * PART_ROWS
        assert rows_of(client) == ROWS
        exported = client.get(f"{BASE}/sim-1/archive/measurements:export", params=EVERYTHING).text.splitlines()
        assert [numbers(line) for line in exported] == [numbers(line) for line in wanted]
        # the export is sent again from another file: everything is known
        (tmp_path / "again.csv").write_text("\n".join(exported) + "\n")
        path = tmp_path / "again.csv"
        code, again = run()
        assert (code, again["accepted"], again["duplicates"]) == (0, 0, ROWS)
        print(f"{ROWS / again['seconds']:.0f} known rows of {len(carriers)} carriers a second")


def rows_of(client: Any) -> int:
    """Return how many rows the service has."""
    return sum(each["rows"] for each in client.get(f"{BASE}/sim-1/sources").json()["rows"])


def numbers(line: str) -> list[Any]:
    """Return a line with its levels as numbers."""
    first, source, *levels = line.split(",")
    return [first, source, *(float(each) if each and each[0] == "-" else each for each in levels)]


@pytest.mark.slow
def test_exit_codes_tell_what_became_of_the_rows(
    start_service: Any,
    spacecraft: dict[str, Any],
    carriers: list[dict[str, Any]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    service = start_service()
    with service.client() as client:
        chaos.set_up(client, spacecraft, carriers)
        monkeypatch.setenv("SOO_KEY", client.headers["Authorization"].partition(" ")[2])
    path = tmp_path / "levels.csv"
    good = [f"2026-01-01T00:{minute:02d}:00Z,-40.{minute:02d},1" for minute in range(12)]
    bad = ["1999-01-01T00:00:00Z,-40.3,1", "yesterday,-40.4,1"]
    path.write_text("\n".join(("epoch,c00_dbm,strange", good[0], *bad, *good[1:], "")))
    app = typer.Typer()
    app.command()(put)
    before = signal.getsignal(signal.SIGTERM)

    def code_of(*options: str, url: str = service.url) -> int:
        given = ["powers", str(path), "--spacecraft", "sim-1", "--source", "sa-9", "--service", url]
        result = CliRunner().invoke(app, [*given, "--state", "last_day=2026-01-01", *options])
        print(result.output)
        return result.exit_code

    try:
        assert code_of("--refuse-unknown") == 2
        assert code_of("--patience", "0", url="http://127.0.0.1:9") == 1
        assert code_of("--dry-run") == 3
        assert code_of() == 3
        path.with_name("levels.csv.refused.csv").rename(tmp_path / "refused.csv")
        path.write_text("epoch,source,c00_dbm\n2026-01-01T00:00:00Z,sa-8,-40\n")
        assert code_of() == 2
        assert code_of("--state", "from_source=sa-8") == 0
    finally:
        signal.signal(signal.SIGTERM, before)
    refused = (tmp_path / "refused.csv").read_text().splitlines()
    assert [line.split(",")[:2] for line in refused] == [
        ["line", "code"],
        ["3", "row.unreadable"],
        ["4", "row.unreadable"],
    ]
