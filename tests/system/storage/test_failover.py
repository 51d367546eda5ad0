"""Failover of the database: the primary is killed, its standby is promoted, services find it and lose nothing."""

import shutil
from contextlib import contextmanager

import chaos_clients as chaos
import pytest
from postgresql_cluster import PostgresqlCluster
from sqlalchemy import create_engine
from sqlalchemy.engine import make_url
from storage_trial import IMPATIENT

pytestmark = [pytest.mark.system, pytest.mark.slow]


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
