"""Backups of either database: one state, proved, put back on either database, and never over anything."""

import json
import sqlite3
from contextlib import closing

import pytest
from sqlalchemy import create_engine, func, inspect, select, text
from stored_records import AUDIT_EVENT

from db.connection.engines import open_engines
from db.maintenance.backup import ARCHIVE_FILE, MANIFEST_FILE, create_backup, restore_backup, verify_backup
from db.storage import SqlStorage
from db.tables import LAYOUT, metadata
from service.ports.archive import ListPart, Outcome
from service.records.catalogue import LIVE_METHODS
from service.records.inputs import Operation
from service.records.operations.access import BrowserSession
from service.records.storage import BackupError, worst

STAMP = "20261122T040302Z"


def ignore(*_):
    """Tell nobody of the progress."""


@pytest.fixture
def filled(setting, make):
    """A spacecraft with something in most tables, and figures whose last bit matters."""
    setting.append([10, 20, 30], [-50.1, -0.0, float("nan")], flags=[(1, 2, 3), None, None], first_seq=7)
    setting.append([15], source="sa-2")
    setting.storage.archive.add_operation(setting.id, Operation(0, "eclipse", 1, 2, comment="тень"))
    setting.calibrate()
    setting.align(5)
    rows = [row for row in setting.rows() if row.feeds_estimator]
    made = [make.attitude_row(row, method, common_db=0.1 + 0.2) for row in rows for method in LIVE_METHODS]
    setting.consume([Outcome(tuple(made), make.torque_command(rows[0]))])
    setting.storage.audit.append(AUDIT_EVENT)
    return setting


def content(url):
    """Return every row of every table, as the code reads it."""
    engines = open_engines(url)
    try:
        with engines.read.connect() as connection:
            return {
                table.name: sorted(repr(tuple(row)) for row in connection.execute(select(table)))
                for table in metadata.sorted_tables
            }
    finally:
        engines.dispose()


@pytest.fixture
def empty(request, tmp_path):
    """Return a maker of URLs of databases without a schema."""
    cluster = []

    def make(kind):
        if kind == "sqlite":
            return f"sqlite:///{tmp_path / 'elsewhere.db'}"
        cluster.append(request.getfixturevalue("postgresql_cluster"))
        made = cluster[0].new_database()
        request.addfinalizer(lambda: cluster[0].drop(made))
        return made

    return make


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_what_is_put_back_is_another_service_where_nobody_is_signed_in(filled, url, empty, tmp_path, kind):
    filled.storage.keys.open_session(BrowserSession(b"digest", "bootstrap", 2**60), 0)
    create_backup(url, tmp_path / "b", 5, ignore)
    elsewhere = empty(kind)
    restore_backup(tmp_path / "b", elsewhere, STAMP, ignore, may_replace=False)
    with closing(SqlStorage(elsewhere)) as other:
        assert other.keys.sessions() == {}
        assert other.keys.service_id() != filled.storage.keys.service_id()
    assert len(filled.storage.keys.sessions()) == 1


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_backup_put_back_on_either_database_is_the_same_archive(filled, url, empty, tmp_path, kind):
    shares = []
    manifest = create_backup(url, tmp_path / "b", 5, lambda step, share: shares.append((step, share)))
    assert ("sha256", 1.0) in shares
    before = content(url)
    assert {name: len(rows) for name, rows in before.items()} == manifest.tables
    count = manifest.spacecraft[filled.id]
    head = filled.storage.archive.head(filled.id)
    assert (count.newest_number, count.consumed_number) == (head.newest_number, head.consumed_number)
    assert count.rows["measurement"] == 4
    assert manifest.made_from == url.partition(":")[0].partition("+")[0]
    found = verify_backup(tmp_path / "b", ignore)
    assert worst(found) == "ok", found
    assert {diagnosis.check for diagnosis in found} >= {"file", "manifest", "integrity", "journal", "counts", "results"}
    target = empty(kind)
    restored = restore_backup(tmp_path / "b", target, STAMP, ignore, may_replace=False)
    assert (restored.aside, restored.manifest.layout) == (None, LAYOUT)
    assert content(target) == before
    # what is given out next goes on behind what was restored
    storage = SqlStorage(target)
    try:
        assert storage.archive.append_measurements(filled.batch([10, 40], [-50.1, -51.0])).result(120).accepted == 1
        assert storage.archive.head(filled.id).newest_number == head.newest_number + 1
        assert (
            storage.archive.measurements(filled.id, ListPart(filled_window(), 99))[-1].number == head.newest_number + 1
        )
    finally:
        storage.close()


def filled_window():
    """Return a window around everything."""
    from service.records.calibration import Window

    return Window(0, 1 << 60)


def test_a_restore_moves_nothing_unless_told_and_keeps_what_it_moves(filled, url, tmp_path):
    create_backup(url, tmp_path / "b", 5, ignore)
    before = content(url)
    filled.append([50, 60], [-1.0, -2.0])
    later = content(url)
    with pytest.raises(BackupError, match="in use" if url.startswith("sqlite") else r"in use|archive"):
        restore_backup(tmp_path / "b", url, STAMP, ignore, may_replace=True)
    filled.storage.close()
    with pytest.raises(BackupError, match="--replace"):
        restore_backup(tmp_path / "b", url, STAMP, ignore, may_replace=False)
    assert content(url) == later
    restored = restore_backup(tmp_path / "b", url, STAMP, ignore, may_replace=True)
    assert content(url) == before
    if url.startswith("sqlite"):
        assert restored.aside.endswith(f"soo.db.before-{STAMP}")
        assert content(f"sqlite:///{restored.aside}") == later
        assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]
        return
    engine = create_engine(url)
    with engine.begin() as connection:
        schema = restored.aside.removeprefix("schema ")
        rows = select(func.count()).select_from(text(f'"{schema}".measurement'))
        assert connection.scalar(rows) == len(later["measurement"])
        assert "archive_layout" in inspect(connection).get_table_names(schema=schema)
        connection.exec_driver_sql(f'DROP SCHEMA "{schema}" CASCADE')
    engine.dispose()


def test_a_restore_that_fails_changes_nothing(filled, url, tmp_path, monkeypatch):
    create_backup(url, tmp_path / "b", 5, ignore)
    filled.storage.close()
    before = content(url)

    def fail(*_):
        message = "no room"
        raise OSError(message)

    monkeypatch.setattr(
        "db.maintenance.backup._moved_aside" if url.startswith("sqlite") else "db.maintenance.backup.copy_tables",
        fail,
    )
    with pytest.raises(OSError, match="no room"):
        restore_backup(tmp_path / "b", url, STAMP, ignore, may_replace=True)
    assert content(url) == before
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_a_backup_has_its_name_only_when_it_is_complete(filled, url, tmp_path, monkeypatch):
    monkeypatch.setattr("db.maintenance.backup.sha256_of", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        create_backup(url, tmp_path / "b", 5, ignore)
    assert not list(tmp_path.glob("*b*.partial")) + list(tmp_path.glob("b"))
    monkeypatch.undo()
    # what a kill has left is no obstacle
    (tmp_path / ".b.partial").mkdir()
    (tmp_path / ".b.partial" / ARCHIVE_FILE).write_text("half")
    create_backup(url, tmp_path / "b", 5, ignore)
    with pytest.raises(BackupError, match="exists"):
        create_backup(url, tmp_path / "b", 5, ignore)
    assert worst(verify_backup(tmp_path / "b", ignore)) == "ok"


@pytest.fixture
def backup(setting, url, tmp_path):
    """A backup of a few rows."""
    if not url.startswith("sqlite"):
        pytest.skip("backups are SQLite files on either database")
    setting.append(range(100))
    create_backup(url, tmp_path / "b", 5, ignore)
    return tmp_path / "b"


def spoil_byte(folder):
    path = folder / ARCHIVE_FILE
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def spoil_count(folder):
    path = folder / MANIFEST_FILE
    document = json.loads(path.read_text())
    document["tables"]["measurement"] += 1
    path.write_text(json.dumps(document))


def spoil_number(folder):
    path = folder / MANIFEST_FILE
    document = json.loads(path.read_text())
    next(iter(document["spacecraft"].values()))["newest_number"] += 1
    path.write_text(json.dumps(document))


def spoil_end(folder):
    path = folder / ARCHIVE_FILE
    path.write_bytes(path.read_bytes()[:-4096])


@pytest.mark.parametrize(
    ("spoil", "check", "said"),
    [
        (spoil_byte, "file", "SHA-256"),
        (spoil_end, "file", "bytes"),
        (lambda folder: (folder / ARCHIVE_FILE).unlink(), "file", "not there"),
        (spoil_count, "manifest", "measurement: 101 in the manifest, 100 in the file"),
        (spoil_number, "manifest", "of a spacecraft"),
    ],
)
def test_a_backup_that_is_not_what_was_written_is_found_and_not_restored(backup, tmp_path, spoil, check, said):
    spoil(backup)
    faults = [diagnosis for diagnosis in verify_backup(backup, ignore) if diagnosis.state == "fault"]
    assert [diagnosis.check for diagnosis in faults] == [check]
    assert said in faults[0].detail
    assert faults[0].advice
    with pytest.raises(BackupError, match="not sound"):
        restore_backup(backup, f"sqlite:///{tmp_path / 'other.db'}", STAMP, ignore, may_replace=True)
    assert not (tmp_path / "other.db").exists()


@pytest.mark.parametrize("text_", [f'{{"layout": {LAYOUT}}}', "no json", "[]"])
def test_a_manifest_that_cannot_be_read_is_said(backup, text_):
    (backup / MANIFEST_FILE).write_text(text_)
    with pytest.raises(BackupError, match="manifest"):
        verify_backup(backup, ignore)


def test_what_is_no_backup_and_what_is_no_archive_is_said(tmp_path):
    with pytest.raises(BackupError, match="no backup"):
        verify_backup(tmp_path, ignore)
    with pytest.raises(BackupError, match="no archive"):
        create_backup(f"sqlite:///{tmp_path / 'none.db'}", tmp_path / "b", 5, ignore)
    sqlite3.connect(tmp_path / "empty.db").close()
    with pytest.raises(BackupError, match="holds no archive"):
        create_backup(f"sqlite:///{tmp_path / 'empty.db'}", tmp_path / "b", 5, ignore)
    (tmp_path / "text.db").write_text("no database at all " * 100)
    with pytest.raises(BackupError, match="cannot be copied"):
        create_backup(f"sqlite:///{tmp_path / 'text.db'}", tmp_path / "b", 5, ignore)
    assert not (tmp_path / "b").exists()
    assert not (tmp_path / "none.db").exists()
