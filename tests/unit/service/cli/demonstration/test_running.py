"""The file of the running demonstration: for its user alone, gone with it, and never believed without a process."""

import json
import os
import subprocess
import sys

import pytest
import typer

from service.cli.demonstration.running import RunningDemonstration, published, running_demonstration

HERE = RunningDemonstration(os.getpid(), "http://127.0.0.1:1", "administrator.key", ("127.0.0.1", 2))


@pytest.fixture(autouse=True)
def path(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / "soo" / "demonstration.json"


def refused(capsys) -> str:
    with pytest.raises(typer.Exit) as ended:
        running_demonstration()
    assert ended.value.exit_code == 1
    return capsys.readouterr().err


@pytest.mark.parametrize("changes", [("127.0.0.1", 2), None])
def test_it_is_found_while_it_runs(path, capsys, changes):
    demonstration = HERE._replace(changes=changes)
    with published(demonstration):
        assert running_demonstration() == demonstration
        assert path.stat().st_mode & 0o777 == 0o600
        assert path.parent.stat().st_mode & 0o777 == 0o700
    assert not path.exists()
    assert "soo demo" in refused(capsys)


def test_the_end_of_an_older_one_leaves_the_newer_one(path):
    with published(HERE):
        path.write_text(json.dumps(HERE._replace(process_id=os.getppid())._asdict()))
    assert path.exists()


def test_a_process_that_was_killed_is_not_running(path, capsys):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait(60)
    path.parent.mkdir()
    path.write_text(json.dumps(HERE._replace(process_id=ended.pid)._asdict()))
    assert "no demonstration" in refused(capsys)


@pytest.mark.parametrize("text", ["", "[]", "null", "{}", '{"process_id": "x"}', '{"process_id": 1, "changes": [1]}'])
def test_a_file_that_holds_something_else_is_none(path, capsys, text):
    path.parent.mkdir()
    path.write_text(text)
    assert "no demonstration" in refused(capsys)
