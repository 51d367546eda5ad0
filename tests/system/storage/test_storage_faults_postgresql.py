"""Faults of a PostgreSQL server under a running service: it is away, it does not answer, somebody holds a lock.

The clients and the comparison are those of ``tests/system/storage/test_storage_faults.py``.
"""

import time

import pytest
from sqlalchemy import create_engine
from storage_trial import IMPATIENT

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.nightly]


def test_a_server_that_stops_and_comes_back(trial, durable_postgresql_cluster):
    cluster = durable_postgresql_cluster
    url = cluster.new_database()
    one = trial(options=("--database", url))
    cluster.program("pg_ctl", "stop", "-D", str(cluster.data), "-m", "fast")
    one.await_code("storage.unavailable")
    assert one.read() == (503, "storage.unavailable")
    assert one.client.get("/readyz").status_code == 503
    assert one.client.get("/healthz").status_code == 200
    cluster.start(fsync=True)
    one.conclude(url)
    cluster.drop(url)


def test_a_server_that_does_not_answer_and_a_lock_that_is_held(trial, durable_postgresql_cluster):
    cluster = durable_postgresql_cluster
    url = cluster.new_database()
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
    cluster.drop(url)
