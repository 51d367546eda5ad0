"""Kill -9 and full disks while results are sealed and summarised: nothing is lost or doubled, the doctor finds nothing.

The archive begins with days of results, live and of a replay, that nobody has sealed. A service is killed again and
again while it does so; after every kill the files are copied and examined by themselves.
"""

import argparse
import os
import random
import shutil
import sqlite3
import time
from contextlib import contextmanager

import numpy as np
import pytest
from sqlalchemy import func, select
from storage_trial import small_volume

from bench.bench_storage import outcome_of, prepare_catalogue
from bench.bench_summaries import STEP_US, append
from db.encoding.segments import DAY_US
from db.maintenance.doctor import diagnose
from db.schema.tables import attitude, metadata, result_segment
from db.storage import SqlStorage
from service.errors import StorageError
from service.ports import LIVE
from service.records.calibration import Window
from service.records.catalogue import LIVE_METHODS
from service.records.operations.job import Job, JobState, Replay
from service.records.storage.checkpoint import Checkpoint
from service.runtime.clock import system_now_us

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.nightly]

SEED = 23
DAYS = 3
ROWS = DAYS * DAY_US // STEP_US
#: segments of two methods and the commands of two versions; summaries of the live one but for its last day
STEPS = 2 * 3 * DAYS + 3 * (DAYS - 1)
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
            found += map(repr, results.attitude_rows("bench", each, method, EVER, 10 * ROWS, None))
        found += map(repr, results.commands("bench", each, EVER, 10 * ROWS, None))
    return found


def sealed_share(storage):
    """Return rows of attitude in their table and in segments."""
    with storage._database.read() as connection:
        of_attitude = select(func.sum(result_segment.c.row_count)).where(result_segment.c.series == "attitude")
        return connection.scalar(select(func.count()).select_from(attitude)), connection.scalar(of_attitude) or 0


def steps_done(database):
    """Return how many segments and summaries there are, beside the process that makes them."""
    other = sqlite3.connect(f"file:{database}?mode=ro", uri=True, timeout=120)
    try:
        queries = ("SELECT count(*) FROM result_segment", "SELECT count(day) FROM attitude_summary")
        return sum(other.execute(query).fetchone()[0] for query in queries)
    finally:
        other.close()


def doubtful(path):
    found = diagnose(f"sqlite:///{path}", system_now_us(), lambda _: None)
    # the disk of the tests' machine may be small
    return [each for each in found if each.state != "ok" and each.check != "disk"]


@pytest.mark.timeout(900)
@pytest.mark.parametrize("kills", [6, pytest.param(60, marks=pytest.mark.nightly)])
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
        assert doubtful(tmp_path / "copy" / "soo.db") == []
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
STORED = ("attitude", "torque", "result_segment", "attitude_summary", "carrier_summary", "checkpoint", "replay")


def contents(storage, version):
    """Return how many rows each table has, where the consumer stands, and all results."""
    with storage._database.read() as connection:
        counts = {name: connection.scalar(select(func.count()).select_from(metadata.tables[name])) for name in STORED}
    return counts, storage.archive.head("bench"), everything(storage, version)


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

        def made(before):
            return sum(1 for _ in results.complete_summaries("bench", before))

        writes = {
            "live rows and their checkpoint": lambda: results.save_outcomes("bench", LIVE, outcomes, *end, state),
            "rows of a replay": lambda: results.save_outcomes("bench", version, outcomes, *end, state),
            "segments": lambda: list(results.seal("bench", 1 << 60)),
            "summaries": lambda: made(1 << 60),
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
        assert doubtful(database) == []
