"""Kill -9 of the service, of the PostgreSQL server and of both, under four posting clients, server with fsync on.

Nobody does anything after a kill but start again what was killed, as a service manager does.
"""

import random
import time

import chaos_clients as chaos
import pytest

from db.maintenance.doctor import diagnose
from service.runtime.clock import system_now_us

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.nightly]

SEED = 21
KILLS_OF_A_NIGHT = 50


@pytest.fixture
def url(durable_postgresql_cluster):
    """URL of an empty database."""
    made = durable_postgresql_cluster.new_database()
    yield made
    durable_postgresql_cluster.drop(made)


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
    start_service, spacecraft, carriers, durable_postgresql_cluster, url, kills, victims
):
    print(f"seed {SEED}")
    instants = random.Random(SEED)
    options = ("--clock", "data", "--database", url)
    service = start_service("--port", "0", *options)
    with service.client() as client:
        plan_id = chaos.set_up(client, spacecraft, carriers)
        key = client.headers["Authorization"].partition(" ")[2]
    port = service.url.rpartition(":")[2]
    clients = chaos.start_clients(service.url, key, plan_id, SEED)
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
    assert [each for each in diagnose(url, system_now_us(), lambda _: None) if each.state != "ok"] == []
    assert service.end()[0] == 0
