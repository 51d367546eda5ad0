"""What a service logged of its journals tells that an archive has lost its newest rows."""

import shutil
import subprocess
import sys
from datetime import UTC, datetime, timedelta

import pytest

pytestmark = [pytest.mark.system, pytest.mark.slow]

BASE = "/api/v1/spacecraft/sim-1"
FIRST = datetime(2026, 11, 1, tzinfo=UTC)


def post(client, first, rows):
    """Post rows of rising epochs, a hundred at once."""
    for start in range(first, first + rows, 100):
        measurements = [
            {"epoch": (FIRST + timedelta(seconds=start + k)).isoformat(), "power_dbm": [-50.0] * 16}
            for k in range(min(100, first + rows - start))
        ]
        answer = client.post(
            f"{BASE}/measurements:batch", json={"plan_id": 1, "source": "sa", "measurements": measurements}
        )
        assert answer.json()["accepted"] == len(measurements), answer.text


def doctor(file, log):
    command = [
        sys.executable,
        "-m",
        "service",
        "doctor",
        "--database",
        f"sqlite:///{file}",
        "--json",
        "--log",
        str(log),
    ]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.mark.nightly
def test_a_thousand_lost_rows_are_told_by_the_log_of_the_service(start_service, spacecraft, carriers, tmp_path):
    file, older = tmp_path / "soo.db", tmp_path / "older.db"
    service = start_service()
    with service.client() as client:
        assert client.post("/api/v1/spacecraft", json=spacecraft).status_code == 201
        assert client.put(f"{BASE}/carriers", json={"carriers": carriers}).status_code == 200
        post(client, 0, 5)
    assert service.end()[0] == 0
    # the state of the file before its log held the next rows
    shutil.copy(file, older)
    service = start_service()
    with service.client() as client:
        post(client, 5, 1000)
    assert service.end()[0] == 0
    assert service.log.read_text().count("journal head sim-1 ") == 2
    whole = doctor(file, service.log)
    assert whole.returncode in {0, 3}, whole.stdout + whole.stderr
    assert "2 entries are those that the log names" in whole.stdout
    lost = doctor(older, service.log)
    assert lost.returncode == 1
    assert "sim-1: 1000 entries are lost" in lost.stdout
    assert doctor(file, tmp_path / "none.log").returncode == 2
    (tmp_path / "empty.log").write_text("nothing\n")
    assert "names no head of a journal" in doctor(file, tmp_path / "empty.log").stderr
