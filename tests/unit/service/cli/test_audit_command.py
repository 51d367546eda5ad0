"""``soo audit verify``: tells a whole chain from one that was changed, by itself or by heads noted elsewhere."""

import json
import sqlite3

import pytest
from typer.testing import CliRunner

from db.storage import SqlStorage
from service.cli.app import app
from service.records.operations.audit import AuditEvent


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
