"""``soo init`` makes what a service starts from, for its owner alone, and overwrites nothing."""

import json
import os
import signal
import stat
import subprocess
import sys

import httpx
import pytest
from typer.testing import CliRunner

from service.cli.app import app
from service.cli.operation.profile import read_profile


@pytest.fixture(autouse=True)
def _own_profile(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "configuration"))


def init(folder, *options):
    return CliRunner().invoke(app, ["init", str(folder), *options])


def test_a_service_starts_from_the_folder_and_its_key_opens_it(tmp_path):
    folder = tmp_path / "it's 100% ours"
    made = json.loads(init(folder, "--json").stdout)
    start = 'set -a; . "$0"; exec "$1" -m service serve --port 0'
    command = ["bash", "-c", start, made["settings"], sys.executable]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("SOO_")}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        try:
            url = json.loads(process.stdout.readline())["url"]
            key = read_profile().key()
            session = httpx.get(f"{url}/api/v1/session", headers={"Authorization": f"Bearer {key}"}, timeout=60.0)
            assert session.json()["role"] == "admin"
            assert read_profile().service == made["service"] == "http://127.0.0.1:8000"
        finally:
            process.send_signal(signal.SIGTERM)
    assert not list(folder.glob("administrator-*.key")), "one first key"


def test_what_it_makes_is_its_owners_alone_and_the_unit_names_it(tmp_path):
    folder = tmp_path / "soo"
    answer = init(folder, "--port", "8100")
    assert answer.exit_code == 0, answer.output
    assert {name: stat.S_IMODE((folder / name).stat().st_mode) for name in ("", "administrator.key", "soo.db")} == {
        "": 0o700,
        "administrator.key": 0o600,
        "soo.db": 0o600,
    }
    assert (folder / "administrator.key").read_text().strip() not in answer.output
    assert "http://127.0.0.1:8100/console/" in answer.output
    unit = (folder / "soo.service").read_text().splitlines()
    assert f"EnvironmentFile={folder / 'soo.env'}" in unit
    assert f'ExecStart="{sys.executable}" -m service serve' in unit


def test_a_folder_that_holds_something_is_left_alone(tmp_path):
    (tmp_path / "notes").write_text("mine")
    answer = init(tmp_path)
    assert (answer.exit_code, "is not empty" in answer.stderr) == (2, True)
    assert [each.name for each in tmp_path.iterdir()] == ["notes"]


def test_a_profile_of_another_service_stays(tmp_path):
    assert init(tmp_path / "one").exit_code == 0
    before = read_profile()
    second = init(tmp_path / "two", "--port", "8100")
    assert (second.exit_code, "the profile stays as it is" in second.stderr) == (0, True)
    assert read_profile() == before
    assert init(tmp_path / "three", "--no-profile").stderr == ""


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    answer = init(tmp_path / "file" / "soo")
    assert (answer.exit_code, "cannot be written" in answer.stderr) == (2, True)


@pytest.mark.parametrize("name", ["SOO_BOOTSTRAP_KEY", "SOO_DATABASE_URL"])
def test_settings_of_another_service_do_not_enter(tmp_path, monkeypatch, name):
    monkeypatch.setenv(name, "sqlite:///elsewhere.db")
    made = json.loads(init(tmp_path / "soo", "--json").stdout)
    assert made["key_file"] == str(tmp_path / "soo" / "administrator.key")
