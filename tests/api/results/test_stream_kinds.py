"""Live stream: what a client chooses, carriers with their rows, and changes of what has no place in a stream."""

from collections.abc import Iterator

import httpx
import numpy as np
import pytest
from served_stream import Reader, Served, Source, serving

from service.ports import LIVE, Outcome
from service.records.catalogue import Method
from service.records.levels.carrier_results import CarrierResults
from service.records.operations.job import Job, JobState
from service.records.operations.link import LinkReport
from service.records.operations.note import Note
from service.runtime.live.live_feed import Cursor, FeedEvent

pytestmark = pytest.mark.anyio
FIRST = "retry: 2000\n\n"


@pytest.fixture
def served(bench, make) -> Iterator[Served]:
    with serving(bench.app, make.key) as served:
        yield served


def blocks(response: httpx.Response, count: int) -> list[str]:
    """Return the next blocks of a stream but heartbeats, as they are sent."""
    found, rest = [], ""
    for text in response.iter_text():
        *whole, rest = (rest + text).split("\n\n")
        found += [block for block in whole if not block.startswith(":")]
        if len(found) >= count:
            return found
    pytest.fail("the stream ended")


async def test_a_client_gets_what_it_chose_and_resumes_behind_what_it_did_not(served, bench, make):
    source = Source(bench, make)
    with served.open(None, "torque") as response:
        retry, place = blocks(response, 2)
        assert retry == FIRST.strip()
        begin = place.removeprefix("id: ")
        source.publish(source.store(2))
    with served.open(begin, "torque", "status") as response:
        reader = Reader(response)
        kinds = [event.kind for event in reader.consume(3, "measurement", "attitude", "torque", "status")]
        assert kinds == ["status", "torque", "torque"]
    number, sequence = (bench.storage.archive.head(make.sc).newest_number, 4)
    with served.open(begin, "alarm") as response:
        # nothing of what came was chosen, so the place alone tells how far the client has got
        assert blocks(response, 3)[1:] == [f"id: {begin}", f"id: {make.sc}:{number}.{sequence}.0"]


async def test_an_unknown_kind_is_refused_with_those_that_there_are(bench):
    answer = await bench.client.get(f"{bench.url}/stream", params={"events": ["alarm", "weather"]})
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (422, "value.choice")
    (error,) = problem["errors"]
    assert error["pointer"] == "/query/events/1"
    assert "'command'" in error["detail"]


async def test_a_slow_client_is_told_nothing_of_kinds_that_it_did_not_choose(served, bench, make):
    source = Source(bench, make)
    with served.open(None, "torque") as response:
        reader = Reader(response)
        batches = [source.store(5) for _ in range(30)]
        for batch in batches:
            source.publish(batch)
        events = reader.consume(150, "torque", "dropped")
        while sum(event.kind == "torque" for event in events) < 150:
            events += reader.consume(1, "torque", "dropped")
    assert {kind for event in events if event.kind == "dropped" for kind in event.data["counts"]} <= {"torque"}


@pytest.mark.parametrize("is_live", [True, False])
async def test_an_attitude_row_comes_with_its_carriers_live_and_from_the_archive(served, bench, make, is_live):
    (row,) = bench.append([make.now_us])
    count = len(row.power_dbm)
    levels_db = np.linspace(-0.5, 0.5, count)
    levels_db[1] = np.nan
    codes = np.arange(count) % 5
    carriers = CarrierResults(row.plan_id, levels_db, levels_db / 3, codes, codes)
    outcome = Outcome((make.row(row, method=Method.ROBUST), make.row(row)), None, carriers=(carriers, None))
    with served.open(None, "attitude", "status") as response:
        (begin,) = Reader(response).consume(1, "status")
    bench.consume([outcome])
    live = (
        FeedEvent("attitude", Cursor(row.number, 1), outcome.rows[0], carriers),
        FeedEvent("attitude", Cursor(row.number, 2), outcome.rows[1]),
    )
    if is_live:
        texts = bench.app.state.stream_parts.texts
        found = [httpx.Response(200, content=texts.of(make.sc, event)).json() for event in live]
    else:
        with served.open(begin.id, "attitude") as response:
            found = [event.data for event in Reader(response).consume(2)]
    robust, paper = found
    assert paper["carriers"] is None
    reported = robust.pop("carriers")
    history = (await bench.get("/attitude/history", method="robust"))["rows"]
    assert robust == history[-1]
    assert (reported["plan_id"], reported["ids"]) == (row.plan_id, [f"c{k:02d}" for k in range(count)])
    assert (reported["state"][2], reported["deviation_db"][1]) == ("excluded", None)
    for position, carrier in enumerate(reported["ids"]):
        (stored,) = (await bench.get(f"/carriers/{carrier}/results", method="robust"))["rows"]
        for name in ("state", "deviation_db", "residual_db"):
            assert reported[name][position] == stored[name], (carrier, name)
    assert robust["version"] == LIVE


def link(state: str) -> LinkReport:
    return LinkReport("sa-1", "analyzer", "yamal-202", "sa-1", state, {}, {"sweeps": 1}, None)


async def test_changes_of_links_jobs_and_notes_come_as_the_lists_tell_them(served, bench, make):
    storage = bench.storage
    storage.links.report([link("MEASURE")], make.now_us)
    storage.results.add_job(Job("j-1", "replay", JobState.QUEUED, 0.0, make.now_us))
    with served.open(None, "status", "link", "job", "note") as response:
        reader = Reader(response)
        # what there is at the first look is no change, and neither are ages
        reader.consume(1, "status")
        storage.notes.add(Note(0, make.sc, make.now_us - 99 * make.s, make.now_us, "ann", "<img onerror>", (), None))
        (note,) = reader.consume(1)
        assert (note.kind, note.data) == ("note", (await bench.client.get("/api/v1/notes")).json()["rows"][0])
        storage.results.update_job("j-1", JobState.RUNNING, 0.5)
        (job,) = reader.consume(1)
        assert (job.kind, job.data) == ("job", (await bench.client.get("/api/v1/jobs/j-1")).json())
        storage.links.report([link("BACKOFF")], make.now_us)
        (changed,) = reader.consume(1)
        assert (changed.kind, changed.data["reported_state"]) == ("link", "BACKOFF")
        storage.links.remove("sa-1")
        storage.links.report([link("MEASURE")], make.now_us)
        (again,) = reader.consume(1)
        assert (again.kind, again.data["reported_state"]) == ("link", "MEASURE")
