"""The doctor on archives with one fault each: the fault is found, named, and nothing else is."""

import os
import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import text
from stored_records import AUDIT_EVENT
from typer.testing import CliRunner

import db.maintenance.doctor
from db.maintenance.doctor import diagnose
from db.maintenance.integrity_check import examine
from service.cli.app import app
from service.ports.archive import LIVE, Outcome
from service.records.inputs import Correction
from service.records.operations.alarms import Alarm, AlarmChange, ChangeKind, Cover, Process, Severity
from service.records.storage import Checkpoint, SealedPart, worst
from service.runtime.clock import system_now_us

DAY_US = 86_400_000_000


def ignore(_name):
    """Tell nobody of the progress."""


@pytest.fixture
def filled(setting, make):
    """Two sealed days, one open one, results, an audit log."""
    for day in range(3):
        setting.append([day * DAY_US + position for position in range(1, 21)], flags=[(1, 2, 3)] + [None] * 19)
    setting.storage.archive.append_inputs(
        setting.id, [Correction(1, 2, make.attitude_row(setting.rows()[0]).attitude_deg)]
    )
    rows = setting.rows()
    setting.consume([Outcome(tuple(make.attitude_row(row) for row in rows), make.torque_command(rows[0]))])
    sealed: list[SealedPart] = list(setting.storage.archive.seal(setting.id, 2 * DAY_US, system_now_us()))
    assert sum(part.rows for part in sealed) == 40
    assert sum(part.rows for part in setting.storage.results.seal(setting.id, DAY_US)) == 21
    for number in range(3):
        setting.storage.audit.append(replace(AUDIT_EVENT, at_us=number))
    return setting


def looked_at(url, now_us=None):
    """Return all that the doctor says."""
    return diagnose(url, system_now_us() if now_us is None else now_us, ignore)


def faults(url, now_us=None):
    """Return checks, and words, of what is not well."""
    return [(found.check, found.detail) for found in looked_at(url, now_us) if found.state != "ok"]


#: settings with which the server of the tests runs to be quick
FSYNC_IS_OFF = "fsync=off"


def of_archive(url, now_us=None):
    """Return what is wrong with the archive, not with the server of the tests."""
    return [(check, detail) for check, detail in faults(url, now_us) if FSYNC_IS_OFF not in detail]


def test_it_says_how_long_the_next_start_takes(filled, url, make, monkeypatch):
    def said():
        found = diagnose(url, system_now_us(), ignore, (), "1/these")
        return [(each.state, each.detail) for each in found if each.check == "restart"]

    assert said() == []
    results, consumed = filled.storage.results, filled.storage.archive.head(filled.id).consumed_number
    for number, fingerprint in ((consumed - 30, "1/these"), (consumed - 5, "0/of others"), (consumed + 9, "1/these")):
        results.save_outcomes(filled.id, LIVE, [], consumed, 1, Checkpoint(number, 1, fingerprint, b""))
    entries = f"the next start of {filled.id} consumes 30 entries since its last checkpoint, 0 s"
    assert said() == [("ok", entries)]
    monkeypatch.setattr("db.maintenance.doctor.LONG_S", 0.01)
    assert [state for state, _ in said()] == ["warning"]


def test_a_sound_archive_is_called_sound_while_it_is_open(filled, url):
    assert of_archive(url) == []
    checks = [found.check for found in looked_at(url)]
    outside = ["file", "permissions", "disk", "wal"] if url.startswith("sqlite") else []
    assert checks[-11:-6] == ["layout", "checksums", "segments", "summaries", "journal"]
    assert checks[-6:] == ["counts", "results", "audit", "clock", "documents", "estimator"]
    assert checks[: len(outside)] == outside
    # and after it was closed in good order
    filled.storage.close()
    assert of_archive(url) == []


DELETE_SEALED = "DELETE FROM segment WHERE series = 'measurement' AND day = 0"
#: statement, check that finds it, words
SPOILT = [
    (
        "DELETE FROM measurement WHERE epoch_us = 172800000005",
        {"journal", "counts", "results"},
        "1 numbers are missing: 48",
    ),
    ("DELETE FROM journal WHERE kind = 'correction'", {"journal"}, "numbers are missing: 64"),
    (DELETE_SEALED, {"journal", "counts", "results"}, "20 numbers are missing: 4, 5, 6, 7, 8 and 15 more"),
    (
        "UPDATE head SET newest_number = 60",
        {"journal", "counts", "results"},
        "4 entries have numbers above the head, 60",
    ),
    ("UPDATE head SET newest_number = 66", {"journal"}, "2 numbers are missing: 65, 66"),
    ("UPDATE head SET consumed_number = 999", {"counts"}, "stands at 999, beyond the journal's 64"),
    ("UPDATE head SET result_sequence = 70", {"results"}, "where the head counts 70"),
    ("UPDATE source SET row_count = 59", {"counts"}, "source sa-1 counts 59 rows and has 60"),
    (
        "DELETE FROM segment WHERE series = 'torque'",
        {"results"},
        "60 results up to 60, where the head counts 61",
    ),
    (
        "UPDATE segment SET last_sequence = last_sequence + 1 WHERE series = 'attitude' AND method = 'robust'",
        {"checksums", "results"},
        "1970-01-01",
    ),
    (
        "UPDATE segment SET plan_id = 9 WHERE series = 'measurement' AND day = 1",
        {"checksums", "segments"},
        "1970-01-02",
    ),
    (
        "UPDATE segment SET row_count = 19 WHERE series = 'measurement' AND day = 1",
        {"checksums", "segments", "counts"},
        "1970-01-02",
    ),
    (
        "UPDATE summary SET content = (SELECT content FROM summary WHERE quantity = 'power_dbm' "
        "ORDER BY segment_id LIMIT 1) WHERE quantity = 'power_dbm'",
        {"checksums", "summaries"},
        "summaries differ from their rows: 1970-01-02",
    ),
    ("UPDATE audit_head SET number = 2", {"audit"}, "the head was left at number 2"),
]


def test_what_was_changed_by_hand_is_found_and_named(filled):
    with filled.storage._database.engines.write.connect() as connection:
        for statement, checks, words in SPOILT:
            with connection.begin() as transaction:
                connection.exec_driver_sql(statement)
                found = examine(connection, ignore)
                transaction.rollback()
            bad = [each for each in found if each.state != "ok" and FSYNC_IS_OFF not in each.detail]
            assert {each.check for each in bad} == checks, statement
            assert any(words in each.detail for each in bad), (statement, bad)
            assert all(each.advice for each in bad)


def test_an_audit_entry_that_was_changed_is_found(filled, url):
    with filled.storage._database.engines.write.begin() as connection:
        if connection.dialect.name == "sqlite":
            connection.exec_driver_sql("DROP TRIGGER audit_entry_no_UPDATE")
        else:
            connection.exec_driver_sql("SET LOCAL session_replication_role = replica")
        connection.exec_driver_sql("UPDATE audit_entry SET who = 'b' WHERE number = 2")
    assert [check for check, _ in of_archive(url)] == ["audit"]


def test_a_clock_that_was_set_back_is_found(filled, url):
    assert [check for check, _ in of_archive(url, now_us=1)] == ["clock"]
    row = filled.rows()[-1]
    with filled.storage._database.engines.write.begin() as connection:
        later = {"at": system_now_us() + 3_600_000_000, "epoch": row.epoch_us}
        connection.execute(text("UPDATE measurement SET delay_us = :at - epoch_us WHERE epoch_us = :epoch"), later)
    found = of_archive(url)
    assert [check for check, _ in found] == ["checksums", "clock"]
    assert " s in the future" in found[1][1]


def test_retention_leaves_no_fault_behind(filled, url):
    dropped = list(filled.storage.archive.drop_before(filled.id, "measurements", DAY_US))
    assert sum(each.rows for each in dropped) == 20
    assert of_archive(url) == []
    assert any("20 taken away by retention" in found.detail for found in looked_at(url))
    # a hole beside what retention took is found all the same
    with filled.storage._database.engines.write.begin() as connection:
        connection.exec_driver_sql("DELETE FROM measurement WHERE epoch_us = 172800000005")
    assert {check for check, _ in of_archive(url)} >= {"journal", "results"}


def test_a_server_that_is_away_is_said():
    found = looked_at("postgresql+psycopg://nobody@127.0.0.1:1/none")
    assert [(each.check, each.state) for each in found] == [("connection", "fault")]
    assert "Start the database" in found[0].advice


def test_a_server_that_does_not_keep_commits_is_said(postgresql_cluster):
    if postgresql_cluster.folder is None:
        pytest.skip("the settings of a server of others are not known")
    url = postgresql_cluster.shared_database()
    assert [check for check, detail in faults(url) if FSYNC_IS_OFF in detail] == ["server"]


@pytest.fixture
def file(filled, url, tmp_path):
    """The file of a closed archive."""
    if not url.startswith("sqlite"):
        pytest.skip("about files")
    filled.storage.close()
    return tmp_path / "soo.db"


def test_a_missing_file_is_said_and_not_made(tmp_path):
    path = tmp_path / "none.db"
    assert faults(f"sqlite:///{path}") == [("file", f"there is no file {path}")]
    assert not path.exists()


def test_pages_that_were_overwritten_are_found(file):
    with file.open("r+b") as opened:
        size = file.stat().st_size
        for page in range(4, size // 4096):
            opened.seek(page * 4096)
            opened.write(b"\x5a" * 512)
    found = faults(f"sqlite:///{file}")
    assert found[0][0] == "integrity"
    assert "damaged" in found[0][1] or "cannot be read" in found[0][1]


def test_a_file_that_is_no_database_is_said(file):
    file.write_bytes(b"no database at all " * 300)
    found = faults(f"sqlite:///{file}")
    assert {check for check, _ in found} <= {"integrity", "layout", "connection"}
    assert "not a database" in found[0][1]


def test_a_row_without_its_parent_is_found(file):
    connection = sqlite3.connect(file)
    connection.execute("INSERT INTO operation VALUES (12345, 1, 1, 1)")
    connection.commit()
    connection.close()
    assert faults(f"sqlite:///{file}") == [("integrity", "1 rows refer to a missing row, the first in table operation")]


@pytest.mark.parametrize(("free_mib", "state"), [(10, "fault"), (500, "warning"), (5000, "ok")])
def test_a_disk_that_runs_full_is_told_before_it_is(file, monkeypatch, free_mib, state):
    usage = shutil.disk_usage(file)._replace(free=free_mib << 20)
    monkeypatch.setattr(db.maintenance.doctor.shutil, "disk_usage", lambda _path: usage)
    found = {each.check: each.state for each in looked_at(f"sqlite:///{file}")}
    assert found["disk"] == state


def test_a_log_that_grew_is_told(file, monkeypatch):
    monkeypatch.setattr(db.maintenance.doctor, "WAL_BYTES_WARNING", 1000)
    connection = sqlite3.connect(file)
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA user_version = 7")
    connection.commit()
    found = faults(f"sqlite:///{file}")
    connection.close()
    assert [check for check, _ in found] == ["wal"]


def test_a_file_that_this_user_cannot_write_is_told(file, monkeypatch):
    monkeypatch.setattr(db.maintenance.doctor.os, "access", lambda path, _mode: Path(path) != file)
    found = faults(f"sqlite:///{file}")
    assert [check for check, _ in found] == ["permissions"]
    assert str(file) in found[0][1]
    monkeypatch.undo()
    monkeypatch.setattr(db.maintenance.doctor.os, "geteuid", lambda: os.getuid() + 1)
    assert [check for check, _ in faults(f"sqlite:///{file}")] == ["permissions"]


def test_documents_that_cannot_be_read_and_an_estimator_that_fails_are_told(filled, url):
    assert [found.state for found in looked_at(url) if found.check in ("documents", "estimator")] == ["ok", "ok"]
    alarm = Alarm(
        *(0, filled.id, "estimator_failed", "step", Process.UNACKNOWLEDGED, Cover.NONE, Severity.CRITICAL),
        *(1, 1, 1, 60.0, 0.0, "s", "no attitude is computed, every step has failed for 60 s"),
    )
    filled.storage.alarms.save([AlarmChange(ChangeKind.RAISED, alarm, 1, True)])
    with filled.storage._database.engines.write.begin() as connection:
        connection.execute(text("UPDATE carrier_plan SET document = replace(document, '\"id\"', '\"name\"')"))
    found = of_archive(url)
    assert [check for check, _ in found] == ["checksums", "documents", "estimator"]
    assert "/1: A stored Carrier cannot be read: id: " in found[1][1]
    assert found[2][1] == f"{filled.id}: no attitude is computed, every step has failed for 60 s"


@pytest.mark.parametrize(
    ("spoil", "code"),
    [
        (None, 0),
        ("UPDATE head SET newest_number = newest_number + 1", 1),
    ],
)
def test_exit_codes_tell_scripts(file, spoil, code):
    if spoil:
        connection = sqlite3.connect(file)
        connection.execute(spoil)
        connection.commit()
        connection.close()
    done = CliRunner().invoke(app, ["doctor", "--database", f"sqlite:///{file}", "--json"])
    # a nearly full disk of the tests' machine is a warning
    assert done.exit_code in ({code, 3} if code == 0 else {code}), done.stderr
    assert ('"state": "fault"' in done.stdout) == (code == 1)
    assert worst([]) == "ok"
