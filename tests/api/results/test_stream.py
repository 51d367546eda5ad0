"""Live stream over a real server: order, resume, slow clients, stop, and what a client chooses."""

import asyncio
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace

import httpx
import numpy as np
import pytest
from fastapi.responses import PlainTextResponse, StreamingResponse
from served_stream import Event, Reader, Served, Source, serving, wait_until
from stored_records import ALARM

from service.ports.archive import LIVE, Outcome
from service.records.catalogue import Method
from service.records.epoch import format_epoch
from service.records.levels.attitude import CarrierResults
from service.records.operations.alarms import AlarmChange, ChangeKind, Note
from service.records.operations.work import Job, JobState, LinkReport
from service.runtime.live.live_feed import Cursor, FeedEvent

pytestmark = pytest.mark.anyio


@pytest.fixture
def served(bench, make) -> Iterator[Served]:
    with serving(bench.app, make.key) as served:
        yield served


@pytest.fixture
def source(bench, make) -> Source:
    return Source(bench, make)


def named(events: list[Event]) -> list[tuple[str, str]]:
    """Return what each event is about."""
    return [(event.kind, event.data["epoch"]) for event in events]


async def test_stream_tells_what_the_rest_interface_tells(served, source, bench, make):
    source.store(1)
    with served.open() as response:
        assert response.headers["content-type"].startswith("text/event-stream")
        assert response.headers["cache-control"] == "no-store"
        reader = Reader(response)
        (status,) = reader.consume(1, "status")
        assert status.data == await bench.get("/status")
        events = source.store(1)
        source.publish(events)
        measurement, attitude, torque = reader.consume(3)
        assert measurement.data == (await bench.get("/measurements/history"))["rows"][-1]
        assert attitude.data.pop("carriers") is None
        assert attitude.data == (await bench.get("/attitude/history"))["rows"][-1]
        assert torque.data == (await bench.get("/torques/history"))["rows"][-1]
        assert [event.kind for event in (measurement, attitude, torque)] == ["measurement", "attitude", "torque"]
        number = events[0].cursor.number
        assert [event.id for event in (status, measurement, attitude, torque)] == [
            f"{make.sc}:{number - 1}.2.0",
            f"{make.sc}:{number}.2.0",
            f"{make.sc}:{number}.3.0",
            f"{make.sc}:{number}.4.0",
        ]
        assert reader.has_heartbeat()
    wait_until(lambda: source.subscribers() == 0)


async def test_stream_without_an_id_starts_with_the_present(served, source):
    published = source.store(3)
    with served.open() as response:
        reader = Reader(response)
        reader.consume(1, "status")
        source.publish(published)
        fresh = source.store(1)
        source.publish(fresh)
        # only what was stored since, in this order
        assert named(reader.consume(3)) == [(event.kind, format_epoch(event.content.epoch_us)) for event in fresh]


async def test_a_result_comes_after_its_row_also_where_both_are_stored_while_the_archive_is_read(
    served, source, bench, monkeypatch
):
    journal, stored = bench.storage.archive.journal, []

    def store_after_the_rows_were_read(*asked, **how):
        entries = journal(*asked, **how)
        monkeypatch.setattr(bench.storage.archive, "journal", journal)
        stored.extend(source.store(1))
        return entries

    monkeypatch.setattr(bench.storage.archive, "journal", store_after_the_rows_were_read)
    with served.open() as response:
        reader = Reader(response)
        wait_until(lambda: stored)
        source.publish(tuple(stored))
        assert named(reader.consume(3)) == [(event.kind, format_epoch(event.content.epoch_us)) for event in stored]


@pytest.mark.parametrize("cut", [0, 4, 9, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2, 3, 5, 6, 7, 8))])
async def test_resume_anywhere_loses_and_doubles_nothing(served, source, cut):
    with served.open() as response:
        reader = Reader(response)
        (status,) = reader.consume(1, "status")
        events = source.store(3)
        source.publish(events)
        seen = reader.consume(cut)
    last = seen[-1].id if seen else status.id
    # more comes while nobody listens, and is published late, when the client is back
    missed = source.store(2)
    with served.open(last) as response:
        reader = Reader(response)
        (status,) = reader.consume(1, "status")
        assert status.id == last
        source.publish(events, missed)
        fresh = source.store(1)
        source.publish(fresh)
        seen += reader.consume(18 - cut)
    for kind in ("measurement", "attitude", "torque"):
        epochs = [event.data["epoch"] for event in seen if event.kind == kind]
        reported = [format_epoch(e.content.epoch_us) for e in (*events, *missed, *fresh) if e.kind == kind]
        assert epochs == reported, kind


async def test_hole_in_the_feed_is_filled_from_the_archive(served, source):
    with served.open() as response:
        reader = Reader(response)
        reader.consume(1, "status")
        source.publish(source.store(1))
        before = reader.consume(3)
        lost = source.store(2)
        fresh = source.store(1)
        source.publish(fresh)
        reported = named(reader.consume(9))
    assert len(before) == 3
    assert sorted(reported) == sorted((e.kind, format_epoch(e.content.epoch_us)) for e in (*lost, *fresh))


async def test_event_without_content_sends_streams_to_the_archive(served, source):
    with served.open() as response:
        reader = Reader(response)
        reader.consume(1, "status")
        stored = source.store(2)
        last = stored[-1].cursor
        source.publish((*stored[:2], FeedEvent("status", last, None)))
        newest = format_epoch(stored[-1].content.epoch_us)
        seen = []
        # a heartbeat between storing and telling sends the new status before the rows
        while len(told := [e for e in seen if e.kind != "status"]) < 6 or not any(
            event.kind == "status" and event.data["newest_attitude"] == newest for event in seen
        ):
            seen += reader.consume(1, "status", "measurement", "attitude", "torque")
        assert named(told) == [(e.kind, format_epoch(e.content.epoch_us)) for e in stored]
        assert told[-1].id == f"yamal-202:{last.number}.{last.sequence}.0"


async def test_slow_client_is_told_and_gets_everything(served, source, bench):
    with served.open() as response:
        reader = Reader(response)
        reader.consume(1, "status")
        batches = [source.store(5) for _ in range(40)]
        for batch in batches:
            source.publish(batch)
            time.sleep(0.002)
        events = reader.consume(601, "measurement", "attitude", "torque", "dropped")
        while sum(event.kind != "dropped" for event in events) < 600:
            events += reader.consume(1, "measurement", "attitude", "torque", "dropped")
    told_of = [event.data for event in events if event.kind == "dropped"]
    # the queue holds 50 events and the reader is slower than the writer; how many are dropped depends on the machine
    assert sum(sum(each["counts"].values()) for each in told_of) > 0
    for each in told_of:
        assert (each["reason"], each["follows"]) == ("slow_client", True)
        for path in each["history"]:
            page = await bench.client.get(path)
            assert page.status_code == 200, path
            assert page.json()["rows"], path
    for kind in ("measurement", "attitude", "torque"):
        epochs = [event.data["epoch"] for event in events if event.kind == kind]
        reported = [format_epoch(e.content.epoch_us) for batch in batches for e in batch if e.kind == kind]
        assert epochs == reported, kind


@pytest.mark.parametrize("beyond", ["900.2.0", "1.900.0"])
async def test_id_beyond_the_archive_starts_with_the_present_and_says_so(served, source, beyond):
    source.store(1)
    with served.open(f"yamal-202:{beyond}") as response:
        reader = Reader(response)
        (status,) = reader.consume(1, "status")
        assert status.id.endswith(".2.0")
        (dropped,) = reader.consume(1, "dropped")
        assert (dropped.data["reason"], dropped.data["follows"]) == ("archive_restored", False)
        fresh = source.store(1)
        source.publish(fresh)
        assert len(reader.consume(3)) == 3


async def test_plan_put_while_streaming_names_its_carriers(served, source, bench, make):
    with served.open() as response:
        reader = Reader(response)
        reader.consume(1, "status")
        plan = bench.storage.catalogue.put_plan(make.sc, [make.carrier(8)], "second")
        (row,) = bench.append([make.now_us], plan_id=plan.id)
        source.publish((FeedEvent("measurement", Cursor(row.number, 0), row),))
        (event,) = reader.consume(1)
        assert event.data["power_dbm"] == {"c08": -42.1}


async def test_open_stream_does_not_hold_up_a_stop(served, source):
    with served.open() as response:
        reader = Reader(response)
        reader.consume(1, "status")
        served.server.should_exit = True
        rest = list(reader._lines)
        served.thread.join(120)
        assert not served.thread.is_alive()
        assert not any(line.startswith("event: error") for line in rest)
    assert source.subscribers() == 0


async def test_many_clients_get_the_same(served, source):
    with ExitStack() as stack:
        readers = [Reader(stack.enter_context(served.open())) for _ in range(5)]
        for reader in readers:
            reader.consume(1, "status")
        events = source.store(4)
        source.publish(events)
        reported = [reader.consume(12) for reader in readers]
    assert all(seen == reported[0] for seen in reported)
    assert named(reported[0]) == [(e.kind, format_epoch(e.content.epoch_us)) for e in events]
    wait_until(lambda: source.subscribers() == 0)


@pytest.mark.parametrize(
    "id_",
    ["900.900", "yamal-202:1.2", "yamal-202:1.2.3.4", "x", "yamal-202:-1.0.0", "Yamal:1.1.1", "1 .2", "1" * 19 + ".0"],
)
async def test_an_id_that_no_stream_gave_is_refused(bench, id_):
    answer = await bench.refused("GET", "/spacecraft/yamal-202/stream", headers={"Last-Event-ID": id_})
    assert answer == (422, "cursor.invalid", ["/header/Last-Event-ID"])


async def test_an_id_of_another_spacecraft_is_refused_by_name(bench):
    answer = await bench.refused("GET", "/spacecraft/yamal-202/stream", headers={"Last-Event-ID": "yamal-201:1.1.0"})
    assert answer == (422, "cursor.spacecraft", ["/header/Last-Event-ID"])


async def test_an_id_older_than_retention_goes_on_with_what_is_kept(served, source, bench, monkeypatch):
    published = source.store(4)
    journal, results = bench.storage.archive.journal, bench.storage.results.results_after
    # as if retention had taken the first two rows with their results
    kept = [event.cursor.number for event in published if event.kind == "measurement"][1]
    monkeypatch.setattr(
        bench.storage.archive, "journal", lambda sc, after, limit, **how: journal(sc, max(after, kept), limit, **how)
    )
    monkeypatch.setattr(
        bench.storage.results, "results_after", lambda sc, after, limit: results(sc, max(after, 4), limit)
    )
    with served.open(f"yamal-202:{kept - 2}.0.0") as response:
        reader = Reader(response)
        (dropped,) = reader.consume(1, "dropped")
        assert (dropped.data["reason"], dropped.data["follows"]) == ("retention", False)
        assert dropped.data["counts"] == {"measurement": 2, "result": 4}
        reported = named(reader.consume(6))
    assert sorted(reported) == sorted(
        (e.kind, format_epoch(e.content.epoch_us)) for e in published[2:4] + published[8:]
    )


async def test_a_resumed_stream_ends_before_a_damaged_row(served, source, bench, caplog):
    first = next(event.cursor for event in source.store(4) if event.kind == "measurement")
    with bench.storage._database.engines.write.begin() as connection:
        connection.exec_driver_sql("UPDATE measurement SET delay_us = delay_us + 1")
    with served.open(f"yamal-202:{first.number - 1}.0.0") as response:
        assert b"event: measurement" not in b"".join(response.iter_bytes())
    assert "storage.corrupt: The measurement row of " in caplog.text


async def test_one_stream_too_many_is_refused_and_room_comes_back(served, source, bench):
    bench.app.state.open_streams._limit = 2
    with served.open() as first, served.open() as second:
        # a reader that nobody holds closes its stream
        readers = [Reader(first), Reader(second)]
        for reader in readers:
            reader.consume(1, "status")
        answer = await bench.refused("GET", "/spacecraft/yamal-202/stream")
        assert answer[:2] == (503, "stream.too_many")
    wait_until(lambda: source.subscribers() == 0)
    with served.open() as response:
        Reader(response).consume(1, "status")


async def test_streams_that_are_asked_for_together_do_not_pass_the_limit(bench, monkeypatch):
    """Found by 508 streams where 500 are given: each looked for room, waited for the archive, then took a place."""
    streams, opened, closing = bench.app.state.open_streams, [], asyncio.Event()
    streams._limit = 3

    async def held(_response, scope, receive, send):
        opened.append(streams.count)
        await closing.wait()
        await PlainTextResponse("over")(scope, receive, send)

    monkeypatch.setattr(StreamingResponse, "__call__", held)
    asked = [asyncio.create_task(bench.client.get(f"{bench.url}/stream")) for _ in range(20)]
    while sum(each.done() for each in asked) + len(opened) < len(asked):
        await asyncio.sleep(0.01)
    closing.set()
    statuses = Counter([(await each).status_code for each in asked])
    assert (statuses, max(opened), streams.count) == ({503: 17, 200: 3}, 3, 0)


async def test_alarms_are_told_and_resumed(served, bench, make):
    def alarm(condition: str) -> AlarmChange:
        raised = replace(ALARM, spacecraft_id=make.sc, condition=condition, raised_at_us=make.now_us)
        return bench.storage.alarms.save([AlarmChange(ChangeKind.RAISED, raised, make.now_us, is_told=True)])[0]

    with served.open() as response:
        reader = Reader(response)
        (status,) = reader.consume(1, "status")
        change = alarm("first")
        bench.context.feed.publish(make.sc, (FeedEvent("alarm", Cursor(0, 0, change.sequence), change),))
        (event,) = reader.consume(1, "alarm")
        assert (event.data["change"], event.data["alarm"]["condition"]) == ("raised", "first")
        # the numbers of rows and results move with what is stored meanwhile; the last one is the alarm's
        assert event.id.startswith(f"{make.sc}:")
        assert event.id.endswith(f".{change.sequence}")
    second = alarm("second")
    with served.open(status.id) as response:
        reported = Reader(response).consume(2, "alarm")
    assert [event.data["alarm"]["condition"] for event in reported] == ["first", "second"]
    assert reported[-1].id.endswith(f".{second.sequence}")


async def test_a_client_that_takes_nothing_is_let_go(served, source, bench):
    object.__setattr__(bench.context.limits, "stream_stall_s", 0.2)
    with served.open() as response:
        Reader(response).consume(1, "status")
        for _ in range(60):
            source.publish(source.store(5))
        # nothing is read; the buffers of both ends hold some hundred events
        wait_until(lambda: source.subscribers() == 0)


FIRST = "retry: 2000\n\n"


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
    storage.results.add_job(Job("j-1", "replay", JobState.RUNNING, 0.0, make.now_us), "somebody")
    with served.open(None, "status", "link", "job", "note") as response:
        reader = Reader(response)
        # what there is at the first look is no change, and neither are ages
        reader.consume(1, "status")
        storage.notes.add(Note(0, make.sc, make.now_us - 99 * make.s, make.now_us, "ann", "<img onerror>", (), None))
        (note,) = reader.consume(1)
        assert (note.kind, note.data) == ("note", (await bench.client.get("/api/v1/notes")).json()["rows"][0])
        assert storage.results.report_job("j-1", "somebody", 0.5)
        (job,) = reader.consume(1)
        assert (job.kind, job.data) == ("job", (await bench.client.get("/api/v1/jobs/j-1")).json())
        storage.links.report([link("BACKOFF")], make.now_us)
        (changed,) = reader.consume(1)
        assert (changed.kind, changed.data["reported_state"]) == ("link", "BACKOFF")
        storage.links.remove("sa-1")
        storage.links.report([link("MEASURE")], make.now_us)
        (again,) = reader.consume(1)
        assert (again.kind, again.data["reported_state"]) == ("link", "MEASURE")
