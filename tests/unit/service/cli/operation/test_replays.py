"""``soo replays``: one line a version, a deleted one first of all."""

import json
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from service.cli.app import app
from service.cli.operation import replays as replays_module

DONE = {
    "version": "replay-1",
    "start": "2026-11-05T00:00:00Z",
    "stop": "2026-11-06T00:00:00Z",
    "state": "done",
    "progress": 1.0,
    "attitude_rows": 2880,
    "torque_rows": 1440,
    "size_bytes": 1_843_200,
}


@pytest.fixture
def deleted(monkeypatch):
    """Numbers that the service was asked to delete."""
    numbers = []
    held = [DONE, DONE | {"version": "replay-2", "state": "running", "progress": 0.25}]
    client = SimpleNamespace(replays=lambda _: held, delete_replay=lambda _, number: numbers.append(number))

    @contextmanager
    def connected(*_):
        yield client

    monkeypatch.setattr(replays_module, "connected", connected)
    return numbers


def test_versions_are_lines_with_state_and_size(deleted):
    lines = CliRunner().invoke(app, ["replays", "--spacecraft", "yamal-202"]).stdout.splitlines()
    span = "2026-11-05T00:00:00Z to 2026-11-06T00:00:00Z"
    assert lines[0] == f"replay-1  {span}  done  2880 rows, 1440 torques, 1.8 MB"
    assert lines[1].startswith(f"replay-2  {span}  running 25%  ")
    assert deleted == []


def test_one_is_deleted_and_the_list_is_json(deleted):
    result = CliRunner().invoke(app, ["replays", "--spacecraft", "yamal-202", "--delete", "3", "--json"])
    assert deleted == [3]
    assert json.loads(result.stdout.splitlines()[0]) == DONE
