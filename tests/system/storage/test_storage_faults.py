"""Faults of the storage under a running service: 503 with a code and Retry-After, nothing acknowledged that is not
kept, and everything goes on by itself when the fault is over: ingest, reads, consumer.

Two clients post through every fault and repeat what is not acknowledged; at the end history, samples and export must
tell exactly what they were promised, every row of the prime source must have its results, and the doctor must find
nothing.
"""

import os
import resource
import shutil
import sqlite3
import subprocess
import time

import chaos_clients as chaos
import pytest
from storage_trial import BASE, IMPATIENT, disk_volume, small_volume

from db.maintenance.backup import create_backup
from db.maintenance.doctor import diagnose
from db.maintenance.restore import restore_backup
from service.runtime.clock import system_now_us

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
    deadline = time.monotonic() + 120
    status = 0
    while status != 200 and time.monotonic() < deadline:
        time.sleep(0.1)
        try:
            status = one.read()[0]
        except OSError:
            status = 0
    reported = {(row["source"], row["epoch"]) for row in chaos.history(one.client)}
    assert reported >= {(source, chaos.text_of(epoch_us)) for source, epoch_us in in_backup}
    row = {"epoch": "2026-11-22T00:00:00Z", "power_dbm": [-50.0] * 16}
    body = {"plan_id": one.plan_id, "source": "sa-0", "measurements": [row]}
    assert one.client.post(f"{BASE}/measurements:batch", json=body).json()["accepted"] == 1
    assert one.service.output.read_text().count("\n") == 1, "the address is announced once"
    assert one.service.end()[0] == 0
    found = diagnose(f"sqlite:///{one.file}", system_now_us(), lambda _: None)
    assert [each for each in found if each.state != "ok" and each.check != "disk"] == []


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
    deadline = time.monotonic() + 120
    # all of the day: what is sealed later would be whole
    while other.execute("SELECT count(*) FROM measurement WHERE epoch_us < ?", (MIDNIGHT_US,)).fetchone()[0]:
        assert time.monotonic() < deadline, "the day was not sealed"
        time.sleep(0.1)
    other.execute("UPDATE measurement_segment SET crc32 = crc32 + 1")
    answer = one.client.get(f"{BASE}/measurements/history", params=day)
    assert (answer.status_code, answer.json()["code"]) == (503, "storage.corrupt")
    assert "2026-11-21" in answer.json()["detail"]
    assert answer.headers["Retry-After"]
    # other days, ingest and consumer are not touched
    assert one.client.get(f"{BASE}/measurements/history", params={"start": "2026-11-22T00:00:00Z"}).status_code == 200
    body["measurements"][0]["epoch"] = "2026-11-23T00:00:01Z"
    assert one.client.post(f"{BASE}/measurements:batch", json=body).json()["accepted"] == 1
    deadline = time.monotonic() + 120
    while (said := one.client.get(f"{BASE}/attitude").json()).get("epoch") != "2026-11-23T00:00:01.000000Z":
        assert time.monotonic() < deadline, said
        time.sleep(0.05)
    faults = [
        each.check
        for each in diagnose(f"sqlite:///{one.file}", system_now_us(), lambda _: None)
        if each.state == "fault"
    ]
    assert set(faults) == {"segments"}
    other.execute("UPDATE measurement_segment SET crc32 = crc32 - 1")
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
