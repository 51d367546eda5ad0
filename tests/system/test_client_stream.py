"""Clients that follow a spacecraft while the service is killed: nothing that was acknowledged is lost or told twice."""

import asyncio
import random
import threading
import time
from collections import Counter

import pytest

from service.client.async_service_client import AsyncServiceClient
from service.client.service_client import ServiceClient, StreamEvent

pytestmark = [pytest.mark.system, pytest.mark.slow]

KEY = "a-key-for-tests-only"
SEED = 20261122
KILLS = 2
SC = "sim-1"


def epoch_of(number: int) -> str:
    """Return the epoch of a row."""
    return time.strftime("%Y-%m-%dT%H:%M:%S.000000Z", time.gmtime(1_795_000_000 + number))


class Sender(threading.Thread):
    """Sends a row every few milliseconds and remembers what was acknowledged."""

    def __init__(self, url: str, plan_id: int) -> None:
        super().__init__()
        self._client = ServiceClient(url, KEY, retries=200, first_wait_s=0.05)
        self._plan_id = plan_id
        self._is_over = threading.Event()
        self.acknowledged: list[str] = []

    def run(self) -> None:
        number = 0
        while not self._is_over.wait(0.01):
            number += 1
            row = {"epoch": epoch_of(number), "power_dbm": [-40.0 - number % 7] * 16}
            receipt = self._client.post_measurements(SC, self._plan_id, [row], source="sa-1")
            assert receipt["accepted"] + receipt["duplicates"] == 1, receipt
            self.acknowledged.append(row["epoch"])

    def finish(self) -> None:
        self._is_over.set()
        self.join(120)
        self._client.close()


def follow(url: str, events: list[StreamEvent], last: threading.Event, wanted: set[str]) -> None:
    """Follow with the synchronous client until every wanted row has come."""
    with ServiceClient(url, KEY) as client:
        for event in client.stream(SC, patience_s=120):
            events.append(event)
            if last.is_set() and wanted <= epochs(events):
                return


async def follow_async(url: str, events: list[StreamEvent], last: threading.Event, wanted: set[str]) -> None:
    """Follow with the asynchronous client until every wanted row has come."""
    async with AsyncServiceClient(url, KEY) as client:
        async for event in client.stream(SC, patience_s=120):
            events.append(event)
            if last.is_set() and wanted <= epochs(events):
                return


def epochs(events: list[StreamEvent]) -> set[str]:
    """Return the epochs of the rows that were told."""
    return {event.data["epoch"] for event in list(events) if event.kind == "measurement"}


def wait_for(is_true, timeout_s: float = 120.0) -> None:
    """Wait for something."""
    deadline = time.monotonic() + timeout_s
    while not is_true():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_streams_survive_kills_of_the_service_without_loss_or_doubling(start_service, spacecraft, carriers):
    print(f"seed {SEED}")
    instants = random.Random(SEED)
    service = start_service()
    url = service.url
    with ServiceClient(url, KEY, timeout_s=120) as client:
        client.create_spacecraft(spacecraft)
        plan_id = client.put_carriers(SC, carriers)["plan_id"]
    reported: dict[str, list[StreamEvent]] = {"sync": [], "async": []}
    last, wanted = threading.Event(), set()
    readers = [
        threading.Thread(target=follow, args=(url, reported["sync"], last, wanted)),
        threading.Thread(target=lambda: asyncio.run(follow_async(url, reported["async"], last, wanted))),
    ]
    for reader in readers:
        reader.start()
    # both have an id to go on from before the first row is sent
    wait_for(lambda: all(reported.values()))
    sender = Sender(url, plan_id)
    sender.start()
    for _ in range(KILLS):
        time.sleep(instants.uniform(0.2, 1.0))
        service.process.kill()
        service.process.wait()
        service = start_service("--port", url.rpartition(":")[2], "--clock", "data")
        service.await_announcement()
    time.sleep(0.5)
    sender.finish()
    wanted.update(sender.acknowledged)
    last.set()
    with ServiceClient(url, KEY, timeout_s=120) as client:
        # one more row wakes readers that have everything already
        row = {"epoch": epoch_of(100_000), "power_dbm": [-40.0] * 16}
        client.post_measurements(SC, plan_id, [row], source="sa-1")
        stored = [
            row["epoch"] for row in client.measurement_history(SC, "2026-01-01T00:00:00Z", "2027-01-01T00:00:00Z")
        ]
    for reader in readers:
        reader.join(120)
        assert not reader.is_alive()
    print(f"{len(wanted)} rows acknowledged, {KILLS} kills")
    assert len(wanted) > KILLS
    assert wanted <= set(stored)
    for name, events in reported.items():
        counts = Counter(event.data["epoch"] for event in events if event.kind == "measurement")
        assert wanted <= counts.keys(), name
        assert set(counts.values()) == {1}, name
        assert not [event for event in events if event.kind == "dropped"], name
        # the order of the journal, which here is that of the epochs
        assert list(counts) == sorted(counts), name
    assert service.end()[0] == 0
