"""What is exported is imported: the same bytes come out of another spacecraft again."""

import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from service.cli.station.send import send

pytestmark = pytest.mark.system

SPAN = {"start": "2026-11-01T00:00:00Z", "stop": "2026-11-02T00:00:00Z"}
ROWS = 500
SEED = 11


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
    app.command()(send)
    before = signal.getsignal(signal.SIGTERM)
    try:
        given = [str(path), "--spacecraft", spacecraft_id, "--source", "sa-1", "--service", url, "--json"]
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
