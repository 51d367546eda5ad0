"""``soo acquire`` refuses what it cannot do before it touches the analyzer."""

import json
import logging
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from service.cli.station.acquire import JsonLines, acquire

TASK: dict[str, Any] = {
    "id": "t",
    "sweeps": [{"id": "a", "start_hz": 950e6, "stop_hz": 990e6, "rbw_hz": 40e3, "points": 2401, "time_s": 2.0}],
    "carriers": [
        {
            "id": "c00",
            "sweep": "a",
            "fc_hz": 960e6,
            "symbol_rate": 1e6,
            "integ_bw_hz": 1.25e6,
            "noise": [[951e6, 954e6]],
        }
    ],
}


def run(task: dict[str, Any], tmp_path: Path, *options: str, key: str = "secret") -> tuple[int, str]:
    """Return exit code and log of the command."""
    app = typer.Typer()
    app.command()(acquire)
    path = tmp_path / "task.json"
    path.write_text(json.dumps(task))
    given = ["--task", str(path), "--spacecraft", "sc", "--json-log", *options]
    result = CliRunner().invoke(app, given, env={"SOO_KEY": key})
    return result.exit_code, result.output


@pytest.fixture(autouse=True)
def _restored_log() -> Any:
    """Give the service's logger back as it was."""
    root = logging.getLogger("service")
    before = (root.handlers, root.level)
    yield
    root.handlers, root.level = before


@pytest.mark.parametrize(
    ("task", "options", "key", "message"),
    [
        (TASK, [], "secret", "no analyzer"),
        (TASK, ["--resource", "TCPIP::x::1::SOCKET"], "", "SOO_KEY is empty"),
        (TASK | {"carriers": []}, ["--resource", "TCPIP::x::1::SOCKET"], "secret", "carriers"),
        (TASK | {"period_s": 1.0}, ["--resource", "TCPIP::x::1::SOCKET"], "secret", "period.too_short"),
    ],
)
def test_wrong_input_ends_with_two_and_its_reason(
    task: dict[str, Any], options: list[str], key: str, message: str, tmp_path: Path
) -> None:
    code, output = run(task, tmp_path, *options, key=key)
    assert code == 2
    assert message in output


def test_a_log_line_is_one_object() -> None:
    record = logging.LogRecord("service.x", logging.WARNING, "f", 1, "level %d", (3,), None)
    record.created = 1.5
    assert json.loads(JsonLines().format(record)) == {
        "time": "1970-01-01T00:00:01.500000Z",
        "level": "warning",
        "logger": "service.x",
        "message": "level 3",
    }
