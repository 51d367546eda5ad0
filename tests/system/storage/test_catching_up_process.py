"""A service that brings a chain back row by row: ready, honest about it, without torques, and ended at once."""

import os
import resource
import time
from contextlib import closing
from pathlib import Path

import pytest
from busy_station import SC

from bench.bench_operation import fill
from db.schema.tables import checkpoint
from db.storage import SqlStorage

pytestmark = [pytest.mark.system, pytest.mark.slow]

#: some seconds of computing
ROWS = 2500
KEY = "a-key-for-tests-only"
PLAIN = {"SOO_BOOTSTRAP_KEY": KEY, "SOO_KERNELS": "numpy", "SOO_ACCESS_LOG": "false"}


def await_true(condition):
    deadline_s = time.monotonic() + 300.0
    while not (found := condition()):
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    return found


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
        await_true(lambda: (head := storage.archive.head(SC)).consumed_number == head.newest_number)
        assert first.end()[0] == 0
        # as after an upgrade that raises the number of the layout
        storage._database.write(lambda connection: connection.execute(checkpoint.delete()))
        service = start_service("--port", "0", "--clock", "data", **options)
        with service.client() as client:

            def ready():
                answer = client.get("/readyz")
                assert answer.status_code == 200, answer.text
                return answer.json()["catching_up"]

            began = await_true(ready)
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
            await_true(lambda: ready()["rows_left"] < began["rows_left"])
        ended_s, before_s = ended_children_s(), processor_s(service.process.pid)
        assert service.end()[0] == 0
        took_s = ended_children_s() - ended_s - before_s
        print(f"ended after {took_s:.2f} s of the processor")
        # of the clock on an idle machine; the rest of the chain would take longer
        assert took_s < 2.0
        assert "Traceback" not in service.written()
