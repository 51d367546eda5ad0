"""An archive is made in one transaction, and one of another layout is refused everywhere with one sentence."""

import json
import shutil
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import pytest
from geometry_flight import FlightPayload
from sqlalchemy import create_engine, inspect
from sqlalchemy.exc import OperationalError
from typer.testing import CliRunner

from db.connection.engines import open_engines
from db.maintenance.backup import MANIFEST_FILE, create_backup, restore_backup, verify_backup
from db.maintenance.doctor import diagnose
from db.storage import SqlStorage
from db.tables import LAYOUT, metadata
from service.cli.app import app
from service.errors import StorageError
from service.records.inputs import TelemetryRecord
from service.records.storage import BackupError

OTHERS = [0, LAYOUT + 1]


def ignore(*_):
    """Tell nobody of the progress."""


@pytest.fixture(params=["sqlite", "postgresql"])
def empty(request, tmp_path):
    """URL of a database without tables."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path / 'soo.db'}"
        return
    cluster = request.getfixturevalue("postgresql_cluster")
    made = cluster.new_database()
    yield made
    cluster.drop(made)


def prepare(url):
    """Make an archive, or open the one that is there."""
    with closing(SqlStorage(url)) as storage:
        storage.prepare()


def run(url, *statements):
    """Run statements on a database."""
    engine = create_engine(url)
    with engine.begin() as connection:
        for statement in statements:
            connection.exec_driver_sql(statement)
    engine.dispose()


def tables(url):
    """Return the names of the tables of a database."""
    engine = create_engine(url)
    names = set(inspect(engine).get_table_names())
    engine.dispose()
    return names


def relaid(url, layout):
    """Give an archive the number of another layout; 0 = none, as development versions made them."""
    run(url, f"UPDATE archive_layout SET number = {layout}" if layout else "DROP TABLE archive_layout")  # noqa: S608


def test_an_archive_is_made_once(empty):
    prepare(empty)
    assert tables(empty) == {*metadata.tables, "archive_layout"}
    run(empty, "INSERT INTO spacecraft (spacecraft_key, id, document, digest) VALUES (1, 'craft', '{}', '')")
    prepare(empty)
    engines = open_engines(empty)
    with engines.read.connect() as connection:
        assert connection.exec_driver_sql("SELECT id FROM spacecraft").scalars().all() == ["craft"]
    engines.dispose()


def test_two_services_that_start_together_make_one_archive(empty):
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(prepare, [empty] * 4)) == [None] * 4
    engines = open_engines(empty)
    with engines.read.connect() as connection:
        assert connection.exec_driver_sql("SELECT number FROM archive_layout").scalars().all() == [LAYOUT]
    engines.dispose()


def test_a_new_file_whose_lock_another_holds_is_waited_for(tmp_path, monkeypatch):
    # SQLite refuses to change the journal of such a file at once, whatever its busy timeout
    with closing(sqlite3.connect(tmp_path / "soo.db", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        monkeypatch.setattr(time, "sleep", lambda _: other.in_transaction and other.execute("ROLLBACK"))
        prepare(f"sqlite:///{tmp_path / 'soo.db'}")
        assert not other.in_transaction
    assert {"archive_layout", "measurement"} <= tables(f"sqlite:///{tmp_path / 'soo.db'}")


def test_a_new_file_that_stays_locked_is_an_error(tmp_path):
    with closing(sqlite3.connect(tmp_path / "soo.db", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        engines = open_engines(f"sqlite:///{tmp_path / 'soo.db'}", limit_s=0.05)
        with pytest.raises(OperationalError, match="locked"):
            engines.read.connect()


def test_an_archive_that_cannot_be_made_leaves_nothing_behind(empty):
    run(empty, "CREATE TABLE trace (id INTEGER)")
    with pytest.raises(StorageError, match="trace"):
        prepare(empty)
    assert tables(empty) == {"trace"}


def test_tables_that_grow_have_no_second_key(tmp_path):
    prepare(f"sqlite:///{tmp_path / 'soo.db'}")
    with closing(sqlite3.connect(tmp_path / "soo.db")) as connection:
        texts = dict(connection.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'"))
    for name in ("measurement", "sequence_interval", "journal", "attitude", "torque"):
        assert texts[name].rstrip().endswith("WITHOUT ROWID")


def test_a_record_costs_the_same_after_many(tmp_path):
    # instructions of SQLite's own machine: a plan that reads the whole journal of a spacecraft shows in them
    counts = Counter()
    with closing(SqlStorage(f"sqlite:///{tmp_path / 'soo.db'}")) as storage:
        storage.prepare()
        craft = FlightPayload.make(4).spacecraft()
        storage.catalogue.add_spacecraft(craft)
        engines = storage._database.engines

        def cost(length):
            storage.archive.append_inputs(craft.id, [TelemetryRecord(length + k, "hold") for k in range(length)])
            for name, engine in (("store", engines.write), ("read", engines.read)):
                with engine.connect() as connection:
                    connection.connection.set_progress_handler(lambda name=name: counts.update([name]), 10)
            counts.clear()
            storage.archive.append_inputs(craft.id, [TelemetryRecord(length - k, "hold") for k in (1, 2)])
            assert len(storage.archive.slow_inputs_before(craft.id, 1 << 62, ("spacecraft", "alignment"))) == 1
            return dict(counts)

        few, many = cost(100), cost(10_000)
    print(f"tens of instructions after 100 records {few}, after 10 000 {many}")
    assert few.keys() == many.keys() == {"store", "read"}
    assert all(many[name] < 2 * few[name] for name in few)


@pytest.mark.parametrize("layout", OTHERS)
def test_an_archive_of_another_layout_is_refused(empty, tmp_path, layout):
    prepare(empty)
    relaid(empty, layout)
    sentence = f"has layout {layout}, this program uses layout {LAYOUT}, .* use the version of SOO that made it"
    with pytest.raises(ValueError, match=sentence):
        prepare(empty)
    with pytest.raises(BackupError, match=sentence):
        create_backup(empty, tmp_path / "b", 5, ignore)
    assert not (tmp_path / "b").exists()
    (fault,) = [each for each in diagnose(empty, 4_000_000_000_000_000, ignore) if each.check == "layout"]
    assert fault.state == "fault"
    assert f"has layout {layout}, " in fault.detail
    assert fault.advice


@pytest.mark.parametrize("layout", OTHERS)
def test_a_backup_of_another_layout_is_refused(empty, tmp_path, layout):
    prepare(empty)
    create_backup(empty, tmp_path / "b", 5, ignore)
    manifest = tmp_path / "b" / MANIFEST_FILE
    document = json.loads(manifest.read_text())
    assert document.pop("layout") == LAYOUT
    manifest.write_text(json.dumps(document | ({"layout": layout} if layout else {})))
    sentence = f"the backup has layout {layout}, .* use the version of SOO that made it"
    with pytest.raises(BackupError, match=sentence):
        verify_backup(tmp_path / "b", ignore)
    with pytest.raises(BackupError, match=sentence):
        restore_backup(tmp_path / "b", empty, "20261122T040302Z", ignore, may_replace=True)


@pytest.mark.parametrize(
    ("command", "code"),
    [
        ("doctor", 1),
        ("maintenance", 2),
        ("audit verify", 2),
        ("backup create x.backup", 1),
    ],
)
def test_every_command_that_opens_the_archive_refuses_another_layout(tmp_path, monkeypatch, command, code):
    monkeypatch.chdir(tmp_path)
    url = f"sqlite:///{tmp_path / 'soo.db'}"
    prepare(url)
    relaid(url, 99)
    shutil.copy(tmp_path / "soo.db", tmp_path / "before.db")
    answer = CliRunner().invoke(app, [*command.split(), "--database", url])
    assert answer.exit_code == code, answer.output
    assert "layout 99" in " ".join(answer.output.split())
    assert (tmp_path / "soo.db").read_bytes() == (tmp_path / "before.db").read_bytes()


def test_the_service_does_not_start_on_another_layout(tmp_path):
    url = f"sqlite:///{tmp_path / 'soo.db'}"
    prepare(url)
    relaid(url, 99)
    command = [sys.executable, "-m", "service", "serve", "--database", url, "--port", "0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert "cannot use the database: the archive has layout 99, " in " ".join(done.stderr.split())
