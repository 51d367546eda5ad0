"""Commands of an archive's keeper: ``soo init``, ``maintenance``, ``audit verify``, ``keys``, ``acquire``."""

import glob
import json
import logging
import os
import shlex
import signal
import sqlite3
import stat
import subprocess
import sys
from configparser import ConfigParser
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from db.storage import SqlStorage
from service.cli.app import app
from service.cli.command_group import state_folder
from service.cli.operation import connection
from service.cli.operation.profile import read_profile
from service.cli.station.acquire import acquire
from service.records.catalogue import Carrier, Site, Spacecraft
from service.records.levels.measurement import MeasurementBatch
from service.records.operations.access import AuditEvent
from service.records.storage import sqlite_url


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


@pytest.mark.parametrize("name", ["a?b", "a#b", "100%20", "a b", "d&e=f", "[a]*"])
def test_what_it_makes_is_in_the_folder_whatever_its_name(tmp_path, name):
    folder = tmp_path / name
    assert init(folder).exit_code == 0
    assert [each.name for each in tmp_path.iterdir() if each.name != "configuration"] == [name]
    assert sorted(each.name for each in folder.iterdir()) == ["administrator.key", "soo.db", "soo.env", "soo.service"]
    stated = dict(shlex.split(line)[0].split("=", 1) for line in (folder / "soo.env").read_text().splitlines())
    kept, restored = str(folder / "kept"), sqlite_url(str(folder / "again.db"))
    for command in (
        ["create", kept, "--database", stated["SOO_DATABASE_URL"]],
        ["restore", kept, "--database", restored],
    ):
        done = CliRunner().invoke(app, ["backup", *command])
        assert done.exit_code == 0, done.output
    assert (folder / "again.db").is_file()
    unit = unit_of(folder)["Service"]
    # systemd reads the name as a pattern
    assert glob.glob(unit["EnvironmentFile"].replace("%%", "%")) == [str(folder / "soo.env")]  # noqa: PTH207


def unit_of(folder):
    """Return the unit, parsed."""
    unit = ConfigParser(interpolation=None)
    unit.optionxform = str
    unit.read(folder / "soo.service")
    return unit


def test_the_unit_confines_the_service(tmp_path):
    assert init(tmp_path / "soo").exit_code == 0
    unit = unit_of(tmp_path / "soo")["Service"]
    confined = {"ProtectSystem": "full", "PrivateTmp": "yes", "NoNewPrivileges": "yes", "MemoryMax": "4G"}
    assert {name: unit[name] for name in confined} == confined


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


DAY_US = 86_400_000_000
#: of 2026, long ago for the system clock of any test
FIRST_US = 20_500 * DAY_US


@pytest.fixture
def url(tmp_path):
    """An archive with a row on each of three days, consumed."""
    made = f"sqlite:///{tmp_path / 'soo.db'}"
    storage = SqlStorage(made)
    storage.prepare()
    inertia = ((4000.0, 0.0, 0.0), (0.0, 2000.0, 0.0), (0.0, 0.0, 4000.0))
    storage.catalogue.add_spacecraft(Spacecraft("craft", "craft", 90.0, Site(55.0, 38.0), inertia, 0.05))
    plan = storage.catalogue.put_plan("craft", [Carrier("c00", "C", "t0", 3.7e9, 5e6)], "sha")
    epochs_us = FIRST_US + np.arange(3) * DAY_US
    powers, stale = np.full((3, 1), -50.0, dtype=np.float32), np.zeros(3, dtype=bool)
    batch = MeasurementBatch("craft", "sa-1", plan.id, FIRST_US, np.arange(3), epochs_us, powers, (None,) * 3, stale)
    storage.archive.append_measurements(batch).result(120)
    head = storage.archive.head("craft")
    storage.results.save_outcomes("craft", "live", [], head.newest_number, head.newest_epoch_us)
    storage.close()
    return made


def reported(url, *options):
    answer = CliRunner().invoke(app, ["maintenance", "--database", url, *options])
    assert answer.exit_code == 0, answer.output
    return answer.output


def test_days_are_sealed_once(url):
    expected = {"sealed_rows": 3, "sealed_results": 0, "dropped_rows": {}, "failed_spacecraft": 0}
    assert json.loads(reported(url, "--json")) == expected
    assert json.loads(reported(url, "--json")) == expected | {"sealed_rows": 0}


def test_what_is_too_old_goes(url, monkeypatch):
    monkeypatch.setenv("SOO_RETENTION__MEASUREMENTS_DAYS", "1")
    assert reported(url) == "sealed 0 rows, 0 results\ndropped 3 rows of measurements\n"


def test_the_doctor_holds_the_archive_against_the_log(url, tmp_path):
    def examined(name, text):
        (tmp_path / name).write_text(text)
        return CliRunner().invoke(app, ["doctor", "--database", url, "--log", str(tmp_path / name), "--json"])

    lost = examined("lost.log", f"started\n{{'message': 'journal head craft 1003 {'0' * 16}'}}\n")
    assert (lost.exit_code, "craft: 998 entries are lost" in lost.stdout) == (1, True), lost.output
    unnamed = examined("none.log", "nothing\n")
    assert (unnamed.exit_code, "names no head of a journal" in unnamed.stderr) == (2, True)


def test_without_an_archive_the_option_is_wrong(tmp_path):
    answer = CliRunner().invoke(app, ["maintenance", "--database", f"sqlite:///{tmp_path / 'none.db'}"])
    assert answer.exit_code == 2


def verify(*arguments):
    return CliRunner().invoke(app, ["audit", "verify", *arguments])


@pytest.fixture
def archive(tmp_path):
    """A database with four entries: its file and the head of the chain."""
    file = tmp_path / "soo.db"
    storage = SqlStorage(f"sqlite:///{file}")
    storage.prepare()
    for k in range(4):
        entry = storage.audit.append(
            AuditEvent(
                at_us=k,
                who="anna",
                key_id="k",
                role="admin",
                address="",
                action="create_key",
                target="/keys/x",
                outcome="done",
                request_id="r",
            )
        )
    storage.close()
    return file, entry.head


def cut_off(file):
    """Take the newest entry away, and the head with it, as the owner of the database can."""
    connection = sqlite3.connect(file)
    connection.execute("DROP TRIGGER audit_entry_no_DELETE")
    connection.execute("DELETE FROM audit_entry WHERE number = 4")
    connection.execute("UPDATE audit_head SET number = 3, hash = (SELECT hash FROM audit_entry WHERE number = 3)")
    connection.commit()
    connection.close()


def test_a_whole_chain(archive, monkeypatch):
    file, head = archive
    result = verify("--database", f"sqlite:///{file}", "--head", f"4:{head.hash}")
    assert (result.exit_code, result.output) == (
        0,
        f"whole: 4 entries, newest hash {head.hash}, 1 heads noted elsewhere\n",
    )
    monkeypatch.setenv("SOO_DATABASE_URL", f"sqlite:///{file}")
    reported = json.loads(verify("--json").output)
    assert reported == {"number": 4, "hash": head.hash, "heads": 0, "findings": []}


def test_a_changed_entry(archive):
    file, _ = archive
    connection = sqlite3.connect(file)
    connection.execute("DROP TRIGGER audit_entry_no_UPDATE")
    connection.execute("UPDATE audit_entry SET who = 'eve' WHERE number = 2")
    connection.commit()
    connection.close()
    result = verify("--database", f"sqlite:///{file}", "--json")
    assert result.exit_code == 1
    assert [each["number"] for each in json.loads(result.output)["findings"]] == [2]


def test_a_cut_end_is_found_by_what_was_announced_only(archive, tmp_path):
    file, head = archive
    cut_off(file)
    where = ("--database", f"sqlite:///{file}")
    assert verify(*where).exit_code == 0
    log = tmp_path / "service.log"
    log.write_text(f"started\naudit head 0 {'0' * 64}\n{{'message': 'audit head 4 {head.hash}'}}\n")
    for noted in (("--log", str(log)), ("--head", f"4:{head.hash}")):
        result = verify(*where, *noted)
        assert (result.exit_code, "entry 4: announced: an announced entry is gone" in result.output) == (1, True)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--database", "sqlite:///none.db"), "there is no file"),
        (("--database", "oracle://x/y"), "not supported"),
        (("--head", "4"), "NUMBER:HASH"),
        (("--log", "none.log"), "cannot read none.log"),
    ],
)
def test_what_cannot_be_looked_at_is_said(arguments, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = verify(*arguments)
    assert (result.exit_code, said in result.output) == (2, True), result.output
    assert list(tmp_path.iterdir()) == []


def test_a_database_without_an_archive_is_said(tmp_path):
    sqlite3.connect(tmp_path / "empty.db").close()
    (tmp_path / "empty.db").touch()
    result = verify("--database", f"sqlite:///{tmp_path / 'empty.db'}")
    assert (result.exit_code, "holds no archive" in result.output) == (2, True)


ROW = {
    "id": "k7d2mzq9xa",
    "name": "olga",
    "role": "operator",
    "state": "valid",
    "expires_at": None,
    "last_used_at": "2026-11-22T10:00:00.000000Z",
}
MADE = {"id": "k7d2mzq9xa", "key": "soo_k7d2mzq9xa_secret", "name": "olga", "role": "operator", "expires_at": None}


@pytest.fixture
def asked(monkeypatch):
    """What was asked of a service that answers as ours does."""
    requests = []

    class Client:
        def request(self, method, path, body=None, *, params=None):
            requests.append((method, path, body, params))
            return {"POST": MADE, "GET": {"rows": [ROW]}, "DELETE": None}[method]

    monkeypatch.setattr(connection, "connected", lambda _service, _key_env: nullcontext(Client()))
    return requests


def soo(*arguments):
    result = CliRunner().invoke(app, ["keys", *arguments])
    assert result.exit_code == 0, result.output
    return result


def test_the_key_alone_goes_to_standard_output(asked):
    made = soo("create", "--name", "olga", "--role", "operator", "--expires", "2027-12-31T00:00:00Z")
    assert made.stdout == MADE["key"] + "\n"
    assert "shown this once" in made.stderr
    assert MADE["key"] not in made.stderr
    body = {"name": "olga", "role": "operator", "expires_at": "2027-12-31T00:00:00Z"}
    body |= {"station": None, "spacecraft": None, "kinds": None}
    assert asked == [("POST", "/keys", body, None)]
    assert json.loads(soo("create", "--name", "olga", "--role", "operator", "--json").stdout) == MADE


def test_keys_are_listed_in_lines_or_as_json(asked):
    line = soo("list").stdout
    assert line.split() == [ROW["id"], "valid", "operator", "expires", "never", "used", ROW["last_used_at"], "olga"]
    assert json.loads(soo("list", "--json", "--revoked").stdout) == [ROW]
    assert [params for *_, params in asked] == [{"revoked": "false"}, {"revoked": "true"}]


def test_a_key_is_revoked_by_its_id(asked):
    assert "k7d2mzq9xa is revoked" in soo("revoke", "k7d2mzq9xa").stdout
    assert asked == [("DELETE", "/keys/k7d2mzq9xa", None, None)]


def test_without_a_key_in_the_environment_nothing_is_asked(monkeypatch):
    monkeypatch.delenv("SOO_KEY", raising=False)
    result = CliRunner().invoke(app, ["keys", "list"])
    assert (result.exit_code, "SOO_KEY is empty" in result.output) == (2, True)


HIDDEN = """
import sys
sys.modules[{name!r}] = None
sys.argv = ["soo", *{words!r}]
from service.__main__ import main
main()
"""
TASK = '{"id": "t", "sweeps": [], "carriers": []}'


@pytest.mark.parametrize(
    ("name", "words", "extra"),
    [
        ("pyvisa", ["acquire", "--task", "task.json", "--spacecraft", "sc"], "station"),
        ("pyvisa", ["demo", "--exit"], "station"),
        ("distributed", ["study", "estimation", "--scheduler", "tcp://127.0.0.1:1"], "cluster"),
        ("distributed", ["study", "closed-loop", "--scheduler", "tcp://127.0.0.1:1"], "cluster"),
        ("matplotlib", ["study", "limit-cycles", "--figures", "drawn"], "study"),
    ],
)
def test_a_missing_package_is_told_by_its_extra(name: str, words: list[str], extra: str, tmp_path) -> None:
    (tmp_path / "task.json").write_text(TASK)
    code = HIDDEN.format(name=name, words=words)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, timeout=300, check=False
    )
    assert done.returncode == 2, done.stderr
    assert f"install the extra {extra}: pip install 'soo[{extra}]'" in done.stderr


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["ack", "abc"], "'alarm': must be a whole number"),
        (["ack", "0"], "'alarm': must be 1 or greater"),
        (["shelve", "1", "--hours", "x"], "'--hours': must be a number"),
        (["handover", "--format", "pdf"], "'--format': 'pdf' is not one of 'md', 'html'."),
        (["demo", "inject", "hail"], "'kind': 'hail' is not one of 'rain', "),
        (["torque", "report", "1", "lost"], "'outcome': 'lost' is not one of 'sent', "),
    ],
)
def test_a_wrong_value_is_said_in_words_of_this_program(command: list[str], said: str) -> None:
    done = CliRunner().invoke(app, command, env={"SOO_SPACECRAFT": "yamal-202", "SOO_KEY": "a-key"})
    assert done.exit_code == 2
    assert f"Invalid value for {said}" in " ".join(done.stderr.split())


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ({"STATE_DIRECTORY": "/var/lib/soo:/var/lib/other", "XDG_STATE_HOME": "/x"}, "/var/lib/soo/spool"),
        ({"XDG_STATE_HOME": "/x"}, "/x/soo/spool"),
        ({"HOME": "/h"}, "/h/.local/state/soo/spool"),
    ],
)
def test_the_first_that_is_set_is_taken(given: dict[str, str], wanted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("STATE_DIRECTORY", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    assert state_folder("spool") == Path(wanted)


ACQUIRE_TASK: dict[str, Any] = {
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
    """Give the log of the process back as it was."""
    root = logging.getLogger()
    before = (root.handlers[:], root.level)
    yield
    root.handlers[:], root.level = before
    logging.captureWarnings(capture=False)


@pytest.mark.parametrize(
    ("task", "options", "key", "message"),
    [
        (ACQUIRE_TASK, [], "secret", "no analyzer"),
        (ACQUIRE_TASK, ["--resource", "TCPIP::x::1::SOCKET"], "", "SOO_KEY is empty"),
        (ACQUIRE_TASK | {"carriers": []}, ["--resource", "TCPIP::x::1::SOCKET"], "secret", "carriers"),
        (ACQUIRE_TASK | {"period_s": 1.0}, ["--resource", "TCPIP::x::1::SOCKET"], "secret", "period.too_short"),
    ],
)
def test_wrong_input_ends_with_two_and_its_reason(
    task: dict[str, Any], options: list[str], key: str, message: str, tmp_path: Path
) -> None:
    code, output = run(task, tmp_path, *options, key=key)
    assert code == 2
    assert message in output
