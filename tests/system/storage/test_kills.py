"""Services and databases that are killed: nothing acknowledged is lost, and another process takes over."""

import json
import os
import random
import resource
import shutil
import signal
import struct
import subprocess
import sys
import time
from contextlib import closing, contextmanager
from pathlib import Path

import chaos_clients as chaos
import pytest
from busy_station import SC
from postgresql_cluster import PostgresqlCluster
from service_process import KEY
from sqlalchemy import create_engine, text
from sqlalchemy.engine import make_url
from storage_trial import IMPATIENT
from waiting import wait_until

from bench.bench_operation import fill
from db.connection.engines import reading_engine
from db.maintenance.backup import restore_backup, verify_backup
from db.maintenance.doctor import diagnose
from db.maintenance.integrity_check import examine
from db.storage import SqlStorage
from db.tables import checkpoint
from service.records.storage import BackupError, worst
from service.runtime.clock import system_now_us

pytestmark = [pytest.mark.system, pytest.mark.slow]


SEED = 20
KILLS_OF_A_NIGHT = 50


def stored_rows(database, copy):
    """Return what the files hold by source and epoch, after an examination found nothing wrong."""
    shutil.rmtree(copy, ignore_errors=True)
    copy.mkdir()
    # a kill before the first write of a start leaves no log
    for path in database.parent.glob("soo.db*"):
        if not path.name.endswith("-shm"):
            shutil.copy(path, copy)
    with reading_engine(copy / "soo.db").connect() as connection:
        found = examine(connection, lambda _: None)
        assert [each for each in found if each.state != "ok"] == []
        query = "SELECT name, epoch_us, powers FROM measurement JOIN source USING (spacecraft_key, source_key)"
        rows = connection.execute(text(query))
        return {(name, epoch_us): powers for name, epoch_us, powers in rows}


@pytest.mark.timeout(900)
@pytest.mark.parametrize("kills", [3, pytest.param(KILLS_OF_A_NIGHT, marks=pytest.mark.nightly)])
def test_kills_of_the_service_lose_and_double_nothing(start_service, spacecraft, carriers, tmp_path, kills):
    print(f"seed {SEED}")
    instants = random.Random(SEED)
    database = tmp_path / "soo.db"
    service = start_service()
    with service.client() as client:
        plan_id = chaos.set_up(client, spacecraft, carriers)
    port = service.url.rpartition(":")[2]
    clients = chaos.start_clients(service.url, KEY, plan_id, SEED)
    for kill in range(kills):
        # anywhere between the first request after the start and well into the stream
        time.sleep(instants.uniform(0.0, 0.6))
        service.process.kill()
        service.process.wait()
        promised = chaos.promised(clients)
        stored = stored_rows(database, tmp_path / "copy")
        assert promised.keys() <= stored.keys(), f"kill {kill}: {len(promised.keys() - stored.keys())} rows lost"
        service = start_service("--port", port, "--clock", "data")
        service.await_announcement()
    time.sleep(0.5)
    counts = chaos.finish(clients)
    promised = chaos.promised(clients)
    with service.client() as client:
        chaos.await_consumed(client, promised)
        reported = chaos.compare(client, promised)
    print(f"{kills} kills of the service: missing 0, doubled 0; {reported}; {dict(counts)}")
    assert counts["repetitions"] >= kills
    assert service.end()[0] == 0
    stored = stored_rows(database, tmp_path / "copy")
    assert stored == {row: struct.pack(f"<{chaos.CARRIERS}f", *powers) for row, powers in promised.items()}


POSTGRESQL_SEED = 21


@pytest.mark.nightly
@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    ("kills", "victims"),
    [
        (3, ("service", "server", "both")),
        *(
            pytest.param(KILLS_OF_A_NIGHT, (victim,), marks=pytest.mark.nightly)
            for victim in ("service", "server", "both")
        ),
    ],
)
def test_kills_lose_and_double_nothing(
    start_service, spacecraft, carriers, durable_postgresql_cluster, durable_url, kills, victims
):
    print(f"seed {POSTGRESQL_SEED}")
    instants = random.Random(POSTGRESQL_SEED)
    options = ("--clock", "data", "--database", durable_url)
    service = start_service("--port", "0", *options)
    with service.client() as client:
        plan_id = chaos.set_up(client, spacecraft, carriers)
    port = service.url.rpartition(":")[2]
    clients = chaos.start_clients(service.url, KEY, plan_id, POSTGRESQL_SEED)
    for kill in range(kills):
        time.sleep(instants.uniform(0.0, 0.6))
        victim = victims[kill % len(victims)]
        if victim in ("server", "both"):
            chaos.kill_server(durable_postgresql_cluster)
        if victim in ("service", "both"):
            service.process.kill()
            service.process.wait()
            # before the server is there again: it is waited for
            service = start_service("--port", port, *options)
        if victim in ("server", "both"):
            chaos.start_server(durable_postgresql_cluster)
        service.await_announcement()
    time.sleep(0.5)
    counts = chaos.finish(clients)
    promised = chaos.promised(clients)
    with service.client() as client:
        chaos.await_consumed(client, promised)
        reported = chaos.compare(client, promised)
    print(f"{kills} kills of {', '.join(victims)}: missing 0, doubled 0; {reported}; {dict(counts)}")
    assert counts["repetitions"] >= kills // 2
    assert [each for each in diagnose(durable_url, system_now_us(), lambda _: None) if each.state != "ok"] == []
    assert service.end()[0] == 0


@pytest.fixture
def primary(durable_postgresql_cluster):
    """A server of its own, since it is killed for good; skips where there is none."""
    assert durable_postgresql_cluster.data.is_dir()
    cluster = PostgresqlCluster(fsync=True)
    yield cluster
    chaos.start_server(cluster)
    cluster.close()


@contextmanager
def standby_of(primary, url):
    """Run a standby that has every commit before it is acknowledged; give the folder of its socket and its data."""
    data, socket = primary.folder / "standby", primary.folder / "s"
    socket.mkdir()
    shutil.chown(socket, primary.data.stat().st_uid)
    where = ("-h", str(primary.folder), "-U", "postgres")
    primary.program("pg_basebackup", *where, "-D", str(data), "-R", "-X", "stream", "-c", "fast")
    options = f"-k {socket} -c listen_addresses='' -c max_connections=200"
    primary.program("pg_ctl", "start", "-w", "-D", str(data), "-l", str(data / "log"), "-o", options)
    try:
        engine = create_engine(url, isolation_level="AUTOCOMMIT")
        with engine.connect() as connection:
            connection.exec_driver_sql("ALTER SYSTEM SET synchronous_standby_names = '*'")
            connection.exec_driver_sql("SELECT pg_reload_conf()")
        engine.dispose()
        yield socket, data
    finally:
        primary.program("pg_ctl", "stop", "-D", str(data), "-m", "immediate")


@pytest.mark.timeout(900)
def test_a_standby_that_is_promoted_has_every_row_and_the_services_find_it(trial, primary):
    url = primary.new_database()
    with standby_of(primary, url) as (socket, data):
        hosts = {"host": (str(primary.folder), str(socket)), "target_session_attrs": "read-write"}
        both = make_url(url).set(query=hosts).render_as_string()
        one = trial(options=("--database", both), settings=IMPATIENT)
        chaos.kill_server(primary)
        # until it is promoted the standby takes no rows, and nobody leads
        one.await_code("storage.unavailable")
        assert one.read() == (503, "storage.unavailable")
        assert one.client.get("/healthz").status_code == 200
        primary.program("pg_ctl", "promote", "-w", "-D", str(data))
        one.conclude(both)


TWO_SEED = 23


def test_nothing_is_lost_or_doubled_when_the_leading_one_is_killed(start_service, spacecraft, carriers, url):
    print(f"seed {TWO_SEED}")
    options = ("--clock", "data", "--database", url)
    services = [start_service("--port", "0", *options)]
    with services[0].client() as client:
        plan_id = chaos.set_up(client, spacecraft, carriers)
    services.append(start_service("--port", "0", *options))
    ports = [service.url.rpartition(":")[2] for service in services]
    assert "this service leads" in services[0].written()
    assert "another service leads" in services[1].written()
    clients = [
        chaos.ChaosClient(service.url, KEY, plan_id, number, 2, TWO_SEED) for number, service in enumerate(services)
    ]
    for client in clients:
        client.start()
    time.sleep(0.3)
    services[0].process.kill()
    services[0].process.wait()
    wait_until(lambda: "this service leads" in services[1].written(), services[1].written)
    services[0] = start_service("--port", ports[0], *options)
    services[0].await_announcement()
    assert "another service leads" in services[0].written()
    counts = chaos.finish(clients)
    promised = chaos.promised(clients)
    for service, answers in zip(services, ({404, 503}, {404, 200}), strict=True):
        with service.client() as client:
            chaos.await_consumed(client, promised)
            reported = chaos.compare(client, promised)
            # the alarm may not have been raised yet; where it stands, only the leading service takes orders
            said = client.post("/api/v1/alarms/1:acknowledge", json={"comment": "seen"})
            assert said.status_code in answers
            assert said.status_code != 503 or said.json()["code"] == "lease.elsewhere"
    print(reported, dict(counts))
    assert [each for each in diagnose(url, system_now_us(), lambda _: None) if each.state == "fault"] == []
    assert [service.end()[0] for service in services] == [0, 0]


def test_a_service_that_is_stopped_hands_over_and_follows_when_it_goes_on(start_service, spacecraft, carriers, url):
    services = [start_service("--port", "0", "--clock", "data", "--database", url)]
    with services[0].client() as client:
        plan_id = chaos.set_up(client, spacecraft, carriers)
    services.append(start_service("--port", "0", "--clock", "data", "--database", url))
    services[1].await_announcement()
    services[0].process.send_signal(signal.SIGSTOP)
    wait_until(lambda: "this service leads" in services[1].written())
    row = {"epoch": "2026-11-21T04:00:00Z", "power_dbm": [-42.0] * len(carriers)}
    batch = {"plan_id": plan_id, "source": "sa-1", "measurements": [row]}
    with services[1].client() as client:
        sent = client.post("/api/v1/spacecraft/sim-1/measurements:batch", json=batch)
        assert sent.json()["accepted"] == 1, sent.text
        wait_until(lambda: 'soo_journal_lag{spacecraft="sim-1"} 0.0' in client.get("/metrics").text)
    services[0].process.send_signal(signal.SIGCONT)
    wait_until(lambda: "the lease is lost" in services[0].written())
    assert [each for each in diagnose(url, system_now_us(), lambda _: None) if each.state == "fault"] == []
    assert [service.end()[0] for service in services] == [0, 0]


#: some seconds of computing
ROWS = 2500
PLAIN = {"SOO_BOOTSTRAP_KEY": KEY, "SOO_ACCESS_LOG": "false"}


def ended_children_s():
    """Return the processor time of all children that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def processor_s(process_id):
    """Return the processor time of a process that lives."""
    fields = Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def test_it_is_ready_says_how_far_it_is_and_ends_at_once(start_service, tmp_path):
    fill(tmp_path, ROWS)
    database = tmp_path / "soo.db"
    options = {"database": database, "environment": PLAIN}
    with closing(SqlStorage(f"sqlite:///{database}")) as storage:
        first = start_service("--port", "0", "--clock", "data", **options)
        wait_until(lambda: (head := storage.archive.head(SC)).consumed_number == head.newest_number)
        assert first.end()[0] == 0
        # as after an upgrade that raises the number of the layout
        storage._database.write(lambda connection: connection.execute(checkpoint.delete()))
        service = start_service("--port", "0", "--clock", "data", **options)
        with service.client() as client:

            def ready():
                answer = client.get("/readyz")
                assert answer.status_code == 200, answer.text
                return answer.json()["catching_up"]

            began = wait_until(ready)
            assert began["spacecraft"] == SC
            assert 0 < began["rows_left"] <= ROWS + 100
            # the newest row is answered, with its age, and gives no torque
            attitude = client.get(f"/api/v1/spacecraft/{SC}/attitude")
            assert attitude.status_code == 200, attitude.text
            assert "catch_up" in attitude.json()["inhibitions"]
            assert attitude.json()["control"]["allowed"] is False
            torque = client.get(f"/api/v1/spacecraft/{SC}/torques").json()
            assert torque["control"]["allowed"] is False
            assert [torque[f"{axis}_n_m"] for axis in ("yaw", "roll", "pitch")] == [0.0] * 3
            wait_until(lambda: ready()["rows_left"] < began["rows_left"])
        ended_s, before_s = ended_children_s(), processor_s(service.process.pid)
        assert service.end()[0] == 0
        took_s = ended_children_s() - ended_s - before_s
        print(f"ended after {took_s:.2f} s of the processor")
        # of the clock on an idle machine; the rest of the chain would take longer
        assert took_s < 2.0
        assert "Traceback" not in service.written()


BACKUP_SEED = 23


def ignore(*_):
    """Tell nobody of the progress."""


def create(folder, url):
    """Make a backup from another process and return its manifest."""
    command = [sys.executable, "-m", "service", "backup", "create", str(folder), "--database", url, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_backup_under_load_holds_what_was_acknowledged_before_it_began(
    start_service, spacecraft, carriers, tmp_path, url
):
    options = ("--port", "0", "--clock", "data", "--database")
    service = start_service(*options, url)
    with service.client() as client:
        plan_id = chaos.set_up(client, spacecraft, carriers)
        clients = chaos.start_clients(service.url, KEY, plan_id, BACKUP_SEED)
        before = wait_until(lambda: chaos.promised(clients), lambda: [client.faults for client in clients])
        manifest = create(tmp_path / "b", url)
        counts = chaos.finish(clients)
        after = chaos.promised(clients)
        assert len(before) < len(after)
        assert counts["repetitions"] == 0, "the backup kept clients from posting"
        # the archive goes on behind the backup
        chaos.compare(client, after)
    assert len(before) <= manifest["tables"]["measurement"] <= len(after)
    assert worst(verify_backup(tmp_path / "b", ignore)) == "ok"
    with pytest.raises(BackupError, match="stop the service first"):
        restore_backup(tmp_path / "b", url, "x", ignore, may_replace=True)
    assert service.end()[0] == 0
    assert restore_backup(tmp_path / "b", url, "x", ignore, may_replace=True).aside is not None
    again = start_service(*options, url)
    with again.client() as client:
        reported = {(row["source"], row["epoch"]) for row in chaos.history(client)}
        assert len(reported) == manifest["tables"]["measurement"]
        assert reported >= {(source, chaos.text_of(epoch_us)) for source, epoch_us in before}
        in_backup = {row: powers for row, powers in after.items() if (row[0], chaos.text_of(row[1])) in reported}
        chaos.await_consumed(client, in_backup)
        chaos.compare(client, in_backup)
    assert again.end()[0] == 0
    found = diagnose(url, system_now_us(), ignore)
    assert [each for each in found if each.state != "ok" and each.check != "disk"] == []
