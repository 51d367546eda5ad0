"""Kill -9 of the service on SQLite under four posting clients: nothing acknowledged is lost, nothing is doubled.

The clients send what front ends send on bad days. After every kill the files are copied and examined by themselves,
before the service sees them again; at the end history, samples and export must tell exactly what was promised.
"""

import random
import shutil
import struct
import time

import chaos_clients as chaos
import pytest
from sqlalchemy import text

from db.connection.sqlite_files import reading_engine
from db.encoding.power_codec import unpack_powers
from db.maintenance.integrity_check import examine

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
        return {(name, epoch_us): unpack_powers([powers])[0].tobytes() for name, epoch_us, powers in rows}


@pytest.mark.timeout(900)
@pytest.mark.parametrize("kills", [3, pytest.param(KILLS_OF_A_NIGHT, marks=pytest.mark.nightly)])
def test_kills_of_the_service_lose_and_double_nothing(start_service, spacecraft, carriers, tmp_path, kills):
    print(f"seed {SEED}")
    instants = random.Random(SEED)
    database = tmp_path / "soo.db"
    service = start_service()
    with service.client() as client:
        plan_id = chaos.set_up(client, spacecraft, carriers)
        key = client.headers["Authorization"].partition(" ")[2]
    port = service.url.rpartition(":")[2]
    clients = chaos.start_clients(service.url, key, plan_id, SEED)
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
