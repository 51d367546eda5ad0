"""Faults of disks and databases, while rows come and while days are sealed."""

import argparse
import os
import random
import resource
import shutil
import sqlite3
import subprocess
import time
from contextlib import contextmanager

import chaos_clients as chaos
import httpx
import numpy as np
import pytest
from sqlalchemy import create_engine, func, select
from storage_trial import BASE, IMPATIENT, disk_volume, doubtful, small_volume
from waiting import wait_until

from bench.bench_storage import outcome_of, prepare_catalogue
from bench.bench_summaries import STEP_US, append
from db.encoding.segments import DAY_US
from db.maintenance.backup import create_backup, restore_backup
from db.storage import SqlStorage
from db.tables import attitude, metadata, segment
from service.errors import StorageError
from service.ports.archive import LIVE, ListPart
from service.records.calibration import Window
from service.records.catalogue import LIVE_METHODS
from service.records.operations.work import Job, JobState, Replay
from service.records.storage import Checkpoint

pytestmark = [pytest.mark.system, pytest.mark.slow]


#: end of the day of the clients' rows
MIDNIGHT_US = chaos.START_US + 86_400_000_000


def test_a_disk_that_takes_no_more_a_lock_and_a_file_that_is_moved(trial, tmp_path):
    one = trial(settings=IMPATIENT)
    pid = one.service.process.pid
    limits = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    # no file of the process may be written beyond the limit
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (16_384, limits[1]))
    one.await_code("storage.unavailable")
    assert one.read()[0] == 200
    assert one.client.get("/healthz").status_code == 200
    resource.prlimit(pid, resource.RLIMIT_FSIZE, limits)
    one.await_rows()

    other = sqlite3.connect(one.file, isolation_level=None, timeout=120)
    other.execute("BEGIN IMMEDIATE")
    one.await_code("storage.unavailable", more=1)
    assert one.read() == (200, None)
    other.execute("ROLLBACK")
    other.close()
    one.await_rows()

    away = tmp_path / "away.db"
    one.file.rename(away)
    one.await_code("storage.gone")
    assert one.read() == (503, "storage.gone")
    assert one.client.get("/readyz").status_code == 503
    assert not one.file.exists(), "a name without a file was made into an empty archive"
    away.rename(one.file)
    one.await_rows()
    assert one.client.get("/readyz").status_code == 200
    one.conclude()


def is_answered(one):
    """Return whether the history is read; the server that ends cuts a connection, also under a request."""
    try:
        return one.read()[0] == 200
    except httpx.TransportError:
        return False


def test_an_archive_that_is_put_in_the_place_of_the_open_one_is_opened(trial, tmp_path):
    one = trial()
    in_backup = chaos.promised(one.clients)
    create_backup(f"sqlite:///{one.file}", tmp_path / "backup", 1, lambda *_: None)
    one.await_rows()
    chaos.finish(one.clients)
    restore_backup(tmp_path / "backup", f"sqlite:///{tmp_path / 'put.db'}", "x", lambda *_: None, may_replace=False)
    # what an operator must not do, and does: the service runs on
    (tmp_path / "put.db").replace(one.file)
    assert one.read() == (503, "storage.replaced")
    wait_until(lambda: is_answered(one), "the archive is opened")
    reported = {(row["source"], row["epoch"]) for row in chaos.history(one.client)}
    assert reported >= {(source, chaos.text_of(epoch_us)) for source, epoch_us in in_backup}
    row = {"epoch": "2026-11-22T00:00:00Z", "power_dbm": [-50.0] * 16}
    body = {"plan_id": one.plan_id, "source": "sa-0", "measurements": [row]}
    assert one.client.post(f"{BASE}/measurements:batch", json=body).json()["accepted"] == 1
    assert one.service.output.read_text().count("\n") == 1, "the address is announced once"
    assert one.service.end()[0] == 0
    assert doubtful(f"sqlite:///{one.file}") == []


@pytest.mark.skipif(os.getuid() != 0, reason="only root mounts volumes")
def test_a_full_volume_and_a_volume_that_is_read_only_at_the_start(trial, start_service, tmp_path):
    with small_volume(tmp_path / "volume", "6m") as volume:
        database = volume / "soo.db"
        # a volume of this size is nearly full from the beginning
        settings = {"SOO_MIN_FREE_DISK_BYTES": "0"}
        one = trial(options=("--database", f"sqlite:///{database}"), settings=settings)
        one.file = database
        with (volume / "filler").open("wb") as filler:
            while shutil.disk_usage(volume).free:
                try:
                    filler.write(b"\0" * 4096)
                    filler.flush()
                except OSError:
                    break
        one.await_code("storage.unavailable")
        assert one.read()[0] == 200
        (volume / "filler").unlink()
        one.conclude()
        subprocess.run(["mount", "-o", "remount,ro", volume], check=True)
        refused = start_service("--port", "0", "--database", f"sqlite:///{database}")
        assert refused.process.wait(120) == 2, refused.written()
        assert "cannot use the database" in refused.written()
        assert "Traceback" not in refused.written()
        subprocess.run(["mount", "-o", "remount,rw", volume], check=True)


def test_a_damaged_day_is_refused_alone(trial):
    settings = {"SOO_SEALING__QUIET_S": "0.1", "SOO_SEALING__PERIOD_S": "0.2"}
    one = trial(settings=settings)
    # the day of the clients' rows ends when the clock of the data passes midnight
    row = {"epoch": "2026-11-23T00:00:00Z", "power_dbm": [-50.0] * 16}
    sources = one.client.get(f"{BASE}/sources").json()["rows"]
    prime = next(each["id"] for each in sources if each["role"] == "prime")
    body = {"plan_id": one.plan_id, "source": prime, "measurements": [row]}
    one.chaos.finish(one.clients)
    assert one.client.post(f"{BASE}/measurements:batch", json=body).json()["accepted"] == 1
    day = {"start": "2026-11-21T00:00:00Z", "stop": "2026-11-22T00:00:00Z"}
    other = sqlite3.connect(one.file, isolation_level=None, timeout=120)
    # all of the day: what is sealed later would be whole
    left = "SELECT count(*) FROM measurement WHERE epoch_us < ?"
    wait_until(lambda: other.execute(left, (MIDNIGHT_US,)).fetchone()[0] == 0, "the day is sealed")
    other.execute("UPDATE segment SET feeding_count = feeding_count + 1 WHERE series = 'measurement'")
    answer = one.client.get(f"{BASE}/measurements/history", params=day)
    assert (answer.status_code, answer.json()["code"]) == (503, "storage.corrupt")
    assert "2026-11-21" in answer.json()["detail"]
    assert answer.headers["Retry-After"]
    # other days, ingest and consumer are not touched
    assert one.client.get(f"{BASE}/measurements/history", params={"start": "2026-11-22T00:00:00Z"}).status_code == 200
    body["measurements"][0]["epoch"] = "2026-11-23T00:00:01Z"
    assert one.client.post(f"{BASE}/measurements:batch", json=body).json()["accepted"] == 1
    newest = "2026-11-23T00:00:01.000000Z"
    wait_until(lambda: one.client.get(f"{BASE}/attitude").json().get("epoch") == newest, "the row is consumed")
    faults = [each.check for each in doubtful(f"sqlite:///{one.file}") if each.state == "fault"]
    assert set(faults) == {"checksums", "segments"}
    other.execute("UPDATE segment SET feeding_count = feeding_count - 1 WHERE series = 'measurement'")
    other.close()
    assert one.client.get(f"{BASE}/measurements/history", params=day).status_code == 200
    assert one.service.end()[0] == 0


@pytest.mark.skipif(os.getuid() != 0, reason="only root mounts volumes")
def test_a_volume_that_turns_read_only_under_the_service(trial, start_service, tmp_path):
    with disk_volume(tmp_path / "volume", "32M") as volume:
        database = volume.folder / "soo.db"
        one = trial(options=("--database", f"sqlite:///{database}"), settings={"SOO_MIN_FREE_DISK_BYTES": "0"})
        one.file = database
        volume.fail()
        one.await_code("storage.unavailable")
        assert one.read()[0] == 200
        assert one.client.get("/healthz").status_code == 200
        # the file system is checked and mounted again, as a failed disk demands, and the service started again
        port = one.service.url.rpartition(":")[2]
        assert one.service.end()[0] == 0
        volume.repair()
        options = ("--clock", "data", "--database", f"sqlite:///{database}")
        one.service = start_service("--port", port, *options, environment=one.environment)
        one.service.await_announcement()
        one.conclude()


@pytest.mark.nightly
def test_a_server_that_stops_and_comes_back(trial, durable_postgresql_cluster, durable_url):
    cluster, url = durable_postgresql_cluster, durable_url
    one = trial(options=("--database", url))
    cluster.program("pg_ctl", "stop", "-D", str(cluster.data), "-m", "fast")
    one.await_code("storage.unavailable")
    assert one.read() == (503, "storage.unavailable")
    assert one.client.get("/readyz").status_code == 503
    assert one.client.get("/healthz").status_code == 200
    cluster.start(fsync=True)
    one.conclude(url)


@pytest.mark.nightly
def test_a_server_that_does_not_answer_and_a_lock_that_is_held(trial, durable_postgresql_cluster, durable_url):
    cluster, url = durable_postgresql_cluster, durable_url
    one = trial(options=("--database", url), settings=IMPATIENT)
    # an answer (2 s and 1 s of grace), a connection (at least 2 s), for keys and for the rows themselves, and load
    bound_s = 60.0
    with cluster.stopped():
        one.await_code("storage.unavailable", more=1)
        began = time.monotonic()
        assert one.read() == (503, "storage.unavailable")
        assert time.monotonic() - began < bound_s
        assert one.client.get("/healthz").status_code == 200
        assert one.slowest_s() < bound_s
    one.await_rows()

    engine = create_engine(url)
    with engine.connect() as other:
        other.exec_driver_sql("SELECT * FROM head FOR UPDATE")
        one.await_code("storage.unavailable", more=1)
        assert one.read() == (200, None)
        other.rollback()
    engine.dispose()
    one.conclude(url)
    assert one.slowest_s() < bound_s


SEED = 23
DAYS = 3
ROWS = DAYS * DAY_US // STEP_US
#: segments of two methods and the commands of two versions
STEPS = 2 * 3 * DAYS
EVER = Window(0, 1 << 60)
SETTINGS = {"SOO_BOOTSTRAP_KEY": "for-tests", "SOO_SEALING__QUIET_S": "0.1", "SOO_SEALING__PERIOD_S": "0.2"}


def fill(database):
    """Store days of rows with their results, under two versions."""
    storage = SqlStorage(f"sqlite:///{database}")
    plan_id = prepare_catalogue(storage, argparse.Namespace(carriers=16))
    job = Job("replay-job", "replay", JobState.DONE, 1.0, 0)
    storage.results.add_job(job)
    version = storage.results.add_replay("bench", Replay(0, 0, 1 << 60, None, None, 1, "journal", job.id, 0)).version
    random_ = np.random.default_rng(SEED)
    for first in range(0, ROWS, 720):
        rows = append(storage, plan_id, first, 720)
        outcomes = [outcome_of(row, random_, has_carriers=True) for row in rows]
        for each in (LIVE, version):
            storage.results.save_outcomes("bench", each, outcomes, rows[-1].number, rows[-1].epoch_us)
    return storage, version


def everything(storage, version):
    """Return all results of both versions, as text."""
    results, found = storage.results, []
    for each in (LIVE, version):
        for method in LIVE_METHODS:
            found += map(repr, results.attitude_rows("bench", each, method, ListPart(EVER, 10 * ROWS)))
        found += map(repr, results.commands("bench", each, ListPart(EVER, 10 * ROWS)))
    return found


def sealed_share(storage):
    """Return rows of attitude in their table and in segments."""
    with storage._database.read() as connection:
        of_attitude = select(func.sum(segment.c.row_count)).where(segment.c.series == "attitude")
        return connection.scalar(select(func.count()).select_from(attitude)), connection.scalar(of_attitude) or 0


def steps_done(database):
    """Return how many segments of results there are, beside the process that makes them."""
    other = sqlite3.connect(f"file:{database}?mode=ro", uri=True, timeout=120)
    try:
        query = "SELECT count(*) FROM segment WHERE series != 'measurement'"
        return other.execute(query).fetchone()[0]
    finally:
        other.close()


@pytest.mark.timeout(900)
@pytest.mark.nightly
@pytest.mark.parametrize("kills", [6, 60])
def test_kills_while_results_are_sealed(start_service, empty_database, tmp_path, kills):
    print(f"seed {SEED}")
    instants, database, original = random.Random(SEED), tmp_path / "soo.db", tmp_path / "filled.db"
    shutil.copy(empty_database, original)
    storage, version = fill(original)
    wanted = everything(storage, version)
    storage.close()
    is_done, partly = True, 0
    for _ in range(kills):
        if is_done:
            for path in tmp_path.glob("soo.db*"):
                path.unlink()
            shutil.copy(original, database)
        service = start_service("--port", "0", "--clock", "data", database=database, environment=SETTINGS)
        service.await_announcement()
        enough, deadline = min(STEPS, steps_done(database) + instants.randint(1, 9)), time.monotonic() + 240
        while steps_done(database) < enough:
            assert time.monotonic() < deadline, service.written()
            time.sleep(0.005)
        service.process.kill()
        service.process.wait()
        is_done = steps_done(database) == STEPS
        shutil.rmtree(tmp_path / "copy", ignore_errors=True)
        (tmp_path / "copy").mkdir()
        for path in tmp_path.glob("soo.db*"):
            shutil.copy(path, tmp_path / "copy")
        storage = SqlStorage(f"sqlite:///{tmp_path / 'copy' / 'soo.db'}")
        rows, sealed = sealed_share(storage)
        assert rows + sealed == 2 * 2 * ROWS
        assert everything(storage, version) == wanted
        storage.close()
        assert doubtful(f"sqlite:///{tmp_path / 'copy' / 'soo.db'}") == []
        partly += rows > 0 and sealed > 0
    assert partly, "no kill came while something was sealed"


@contextmanager
def full(volume, database):
    """Fill a volume until it takes no more."""
    # what was written once is written over without more room
    other = sqlite3.connect(database, isolation_level=None)
    other.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    other.close()
    filler = volume / "filler"
    with filler.open("wb", buffering=0) as file:
        try:
            while file.write(b"\0" * 65_536) == 65_536:
                pass
        except OSError:
            pass
    assert shutil.disk_usage(volume).free == 0
    yield
    filler.unlink()


#: tables that the writes touch
STORED = ("attitude", "torque", "segment", "summary", "checkpoint", "replay")


def contents(storage, version):
    """Return how many rows each table has, where the consumer stands, and all results."""
    with storage._database.read() as connection:
        counts = {name: connection.scalar(select(func.count()).select_from(metadata.tables[name])) for name in STORED}
    return counts, storage.archive.head("bench"), everything(storage, version)


@pytest.mark.nightly
@pytest.mark.skipif(os.getuid() != 0, reason="only root mounts volumes")
def test_a_full_disk_fails_each_write_whole(empty_database, tmp_path):
    with small_volume(tmp_path / "volume", "96m") as volume:
        database = volume / "soo.db"
        shutil.copy(empty_database, database)
        storage, version = fill(database)
        rows = append(storage, storage.catalogue.plan("bench").id, ROWS, 720)
        outcomes = [outcome_of(row, np.random.default_rng(SEED), has_carriers=True) for row in rows]
        end = (rows[-1].number, rows[-1].epoch_us)
        state = Checkpoint(*end, "fingerprint", b"state" * 20_000)
        results = storage.results

        writes = {
            "live rows and their checkpoint": lambda: results.save_outcomes("bench", LIVE, outcomes, *end, state),
            "rows of a replay": lambda: results.save_outcomes("bench", version, outcomes, *end, state),
            "segments": lambda: list(results.seal("bench", 1 << 60)),
            "deleted version": lambda: list(results.drop_replays("bench", 1 << 60)),
        }
        for name, write in writes.items():
            before = contents(storage, version)
            with full(volume, database):
                with pytest.raises(StorageError) as caught:
                    write()
                assert caught.value.code == "storage.unavailable", name
                assert "full" in str(caught.value), (name, str(caught.value))
                found = contents(storage, version)
                assert found == before, name
            write()
            assert (contents(storage, version) if "deleted" not in name else None) != before, name
        storage.close()
        assert doubtful(f"sqlite:///{database}") == []
