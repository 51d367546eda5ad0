"""Live stream over either database: rows in order as they are stored, resume into days that were sealed meanwhile."""

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from served_stream import Event, Reader, Served, Source, serving

from db.storage import SqlStorage
from service.api.stream.events import cursor_of

pytestmark = pytest.mark.anyio
DAY_US = 86_400_000_000


@pytest.fixture(params=["sqlite", "postgresql"])
def storage(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[SqlStorage]:
    if request.param == "sqlite":
        url = f"sqlite:///{tmp_path / 'soo.db'}"
    else:
        url = request.getfixturevalue("postgresql_cluster").new_database()
    opened = SqlStorage(url)
    opened.prepare()
    yield opened
    opened.close()


@pytest.fixture
def served(bench, make) -> Iterator[Served]:
    with serving(bench.app, make.key) as served:
        yield served


def reported(events: list[Event]) -> list[tuple[str, object]]:
    """Return kinds and contents, without places."""
    return [(event.kind, event.data) for event in events]


def seal(bench, make, days: int) -> int:
    """Seal the days before an instant and return how many rows that were."""
    before_us = (make.now_us // DAY_US + days) * DAY_US
    return sum(part.rows for part in bench.storage.archive.seal(make.sc, before_us, 1 << 60))


async def test_resume_into_a_day_that_was_sealed_meanwhile_is_as_if_it_was_not(served, bench, make):
    source = Source(bench, make)
    with served.open() as response:
        reader = Reader(response)
        reader.consume(1, "status")
        source.publish(source.store(4))
        whole = reader.consume(12)
    assert seal(bench, make, days=1) == 4
    for cut in (0, 2, 3, 5, 11):
        with served.open(whole[cut].id) as response:
            again = Reader(response).consume(11 - cut) if cut < 11 else []
        for kind in ("measurement", "attitude", "torque"):
            wanted = [event for event in whole[cut + 1 :] if event.kind == kind]
            assert reported([event for event in again if event.kind == kind]) == reported(wanted), (cut, kind)


async def test_rows_stored_after_the_sealing_follow_those_of_the_sealed_day(served, bench, make):
    source = Source(bench, make)
    with served.open() as response:
        (status,) = Reader(response).consume(1, "status")
    source.store(3)
    seal(bench, make, days=1)
    with served.open(status.id) as response:
        reader = Reader(response)
        seen = reader.consume(9)
        source.publish(source.store(2))
        seen += reader.consume(6)
    history = (await bench.get("/measurements/history"))["rows"]
    assert [event.data for event in seen if event.kind == "measurement"] == history[-5:]
    assert len({event.id for event in seen}) == len(seen) == 15


async def test_rows_that_are_posted_come_once_and_in_order(served, bench, make):
    supervisor = bench.context.supervisor
    supervisor.start()
    path = f"{served.url}/api/v1/spacecraft/{make.sc}/measurements:batch"
    headers = {"Authorization": f"Bearer {served.key}"}
    with served.open() as response, httpx.Client(headers=headers, timeout=120) as client:
        reader = Reader(response)
        reader.consume(1, "status")
        seen: list[Event] = []
        for k in range(3):
            row = {
                "epoch": f"2026-11-21T02:59:5{k}.000000Z",
                "power_dbm": [-40.0 - k, None, -42.1, -43.0, -44.0, -45.0],
            }
            answer = client.post(path, json={"plan_id": 1, "source": "sa-1", "first_seq": k, "measurements": [row]})
            assert answer.json()["accepted"] == 1
            supervisor.notify(make.sc)
            seen += reader.consume(1)
    history = (await bench.get("/measurements/history"))["rows"]
    assert [event.data for event in seen] == history
    positions = [position for event in seen if (position := cursor_of(make.sc, event.id))]
    assert [position.number - positions[0].number for position in positions] == [0, 1, 2]
    # told by the writer and by the journal, sent once
    with served.open(seen[0].id) as response:
        assert Reader(response).consume(2) == seen[1:]
