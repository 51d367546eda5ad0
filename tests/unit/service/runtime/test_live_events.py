"""Live events: rows are published once in the order of the journal, and subscribers are told what they lost."""

import asyncio
import threading
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from stored_records import zeros

from service.ports.archive import Outcome
from service.records.catalogue import Method
from service.records.inputs import AlignmentSet, JournalEntry, SpacecraftChange
from service.records.levels.attitude import AttitudeRow, row_without_attitude
from service.records.levels.measurement import BatchReceipt, CarrierDetails, Measurement
from service.runtime.live.journal_consumer import result_events
from service.runtime.live.live_feed import CommittedRows, Cursor, DroppedRows, FeedEvent, LiveFeed, stored_rows

pytestmark = pytest.mark.anyio


def events(*numbers):
    return tuple(FeedEvent("status", Cursor(number, number), None) for number in numbers)


def numbers(found):
    return [event.cursor.number for event in found]


async def test_events_arrive_in_order_and_none_is_lost():
    feed = LiveFeed()
    one, two = feed.subscribe("a"), feed.subscribe("a")
    feed.publish("a", events(1, 2))
    feed.publish("a", events(3))
    await asyncio.sleep(0)
    for subscription in (one, two):
        found, dropped = await subscription.next_events(1.0)
        assert (numbers(found), dropped) == ([1, 2, 3], DroppedRows())
    assert await one.next_events(0.01) == ((), DroppedRows())


async def test_requests_get_their_turn_between_the_subscribers_of_one_event():
    """500 of them were woken in one turn, and a row that came then waited for all: 10.8 times as long as before."""
    feed, woken = LiveFeed(), []
    subscriptions = [feed.subscribe("a") for _ in range(100)]

    async def read(subscription):
        found = []
        while len(found) < 3:
            found += numbers((await subscription.next_events(120.0))[0])
            woken.append(subscription)
        return found

    readers = [asyncio.ensure_future(read(each)) for each in subscriptions]
    await asyncio.sleep(0)
    feed.publish("a", events(1, 2))
    feed.publish("a", events(3))
    turns = []
    while not all(reader.done() for reader in readers):
        before = len(woken)
        await asyncio.sleep(0)
        turns.append(len(woken) - before)
    assert [await reader for reader in readers] == [[1, 2, 3]] * 100
    assert max(turns) <= 20


async def test_a_waiting_subscriber_wakes_up_for_events_from_another_thread():
    feed = LiveFeed()
    subscription = feed.subscribe("a")
    threading.Timer(0.05, feed.publish, ("a", events(7))).start()
    found, _ = await subscription.next_events(120.0)
    assert numbers(found) == [7]


async def test_a_slow_subscriber_loses_the_oldest_and_is_told_how_many():
    feed = LiveFeed(capacity=3)
    slow, quick = feed.subscribe("a"), feed.subscribe("a")
    feed.publish("a", events(1, 2))
    await asyncio.sleep(0)
    assert numbers((await quick.next_events(1.0))[0]) == [1, 2]
    feed.publish("a", events(3, 4, 5))
    await asyncio.sleep(0)
    found, dropped = await slow.next_events(1.0)
    assert (numbers(found), dropped.counts) == ([3, 4, 5], {"status": 2})
    assert (numbers((await quick.next_events(1.0))[0])) == [3, 4, 5]
    feed.publish("a", events(6))
    await asyncio.sleep(0)
    # what was told once is not told again
    assert await slow.next_events(1.0) == (events(6), DroppedRows())


async def test_others_spacecraft_and_former_subscribers_hear_nothing():
    feed = LiveFeed()
    other, gone = feed.subscribe("b"), feed.subscribe("a")
    feed.unsubscribe("a", gone)
    feed.unsubscribe("nobody", gone)
    feed.publish("a", events(1))
    await asyncio.sleep(0)
    assert await other.next_events(0.01) == ((), DroppedRows())
    assert await gone.next_events(0.01) == ((), DroppedRows())


async def test_a_subscriber_whose_loop_is_closed_is_passed_over():
    feed = LiveFeed()

    async def subscribe():
        return feed.subscribe("a")

    loop = asyncio.new_event_loop()
    gone = await asyncio.to_thread(loop.run_until_complete, subscribe())
    loop.close()
    here = feed.subscribe("a")
    feed.publish("a", events(1))
    assert numbers((await here.next_events(1.0))[0]) == [1]
    assert gone.loop is loop


async def test_what_was_dropped_is_told_by_kind_and_span():
    feed = LiveFeed(capacity=1)
    slow = feed.subscribe("a")
    contents = {k: SimpleNamespace(epoch_us=1_000_000 * k) for k in (3, 1, 2)}
    rows = tuple(FeedEvent("measurement", Cursor(k, 0), content) for k, content in contents.items())
    feed.publish("a", rows)
    await asyncio.sleep(0)
    found, dropped = await slow.next_events(1.0)
    assert numbers(found) == [2]
    assert dropped == DroppedRows(Counter({"measurement": 2}), 1_000_000, 3_000_000)
    assert dropped
    assert not DroppedRows()


class Listener(LiveFeed):
    """A feed with one listener, who writes down what comes."""

    def __init__(self) -> None:
        super().__init__()
        self.numbers: list[int] = []

    def has_subscribers(self, spacecraft_id: str) -> bool:
        """Return whether it is the spacecraft that the listener wants."""
        return spacecraft_id == "sc"

    def publish(self, spacecraft_id: str, events: tuple[FeedEvent, ...]) -> None:
        """Write down the numbers of the rows."""
        assert spacecraft_id == "sc"
        self.numbers += [event.cursor.number for event in events]


@pytest.fixture
def listener():
    return Listener()


@pytest.fixture
def publisher_events(listener):
    """Return news of a journal that is followed from behind number 10."""
    events = CommittedRows(listener)
    events.begin("sc", 10)
    return events


def stored(events: CommittedRows, first: int, rows: int = 1, **changes: int) -> None:
    """Tell of a batch that was stored under the numbers from ``first`` on."""
    receipt = BatchReceipt(rows, 0, 0, (), first_number=first, feeds_estimator=True)
    events.stored(zeros(rows), replace(receipt, **changes))  # type: ignore[arg-type]


def followed(events: CommittedRows, *numbers: int) -> None:
    """Come to entries of the journal."""
    (row,) = stored_rows(zeros(1), BatchReceipt(1, 0, 0, (), first_number=1))
    events.followed("sc", [JournalEntry(number, replace(row, number=number)) for number in numbers])


def test_what_the_writer_told_is_not_told_again(publisher_events, listener):
    stored(publisher_events, 11, rows=2)
    stored(publisher_events, 13)
    followed(publisher_events, 11, 12, 13, 14)
    stored(publisher_events, 15)
    assert listener.numbers == [11, 12, 13, 14, 15]


def test_rows_behind_something_else_are_left_to_who_follows_the_journal(publisher_events, listener):
    # 11 is of another service, or no row: telling 12 now would hide it for good
    stored(publisher_events, 12)
    stored(publisher_events, 13)
    assert listener.numbers == []
    followed(publisher_events, 11, 12)
    publisher_events.followed("sc", [JournalEntry(13, AlignmentSet(1))])
    stored(publisher_events, 14)
    assert listener.numbers == [11, 12, 14]


def test_who_follows_comes_first(publisher_events, listener):
    followed(publisher_events, 11)
    stored(publisher_events, 11)
    assert listener.numbers == [11]


def test_a_journal_that_nobody_follows_yet_is_not_told(publisher_events, listener):
    fresh = CommittedRows(listener)
    stored(fresh, 1)
    assert listener.numbers == []


def test_following_anew_from_further_back_tells_nothing_twice(publisher_events, listener):
    stored(publisher_events, 11)
    publisher_events.begin("sc", 10)
    followed(publisher_events, 11, 12)
    assert listener.numbers == [11, 12]


@pytest.mark.parametrize(
    "changes",
    [{"accepted": 1, "duplicates": 1}, {"accepted": 0, "first_number": None}],
    ids=["a duplicate among them", "nothing stored"],
)
def test_batches_in_part_are_left_to_who_follows_the_journal(publisher_events, listener, changes):
    stored(publisher_events, 11, rows=2, **changes)
    assert listener.numbers == []


def test_a_backlog_is_left_to_who_follows_the_journal(publisher_events, listener):
    stored(publisher_events, 11, rows=17)
    assert listener.numbers == []


def test_rows_without_a_listener_count_as_told(listener):
    events = CommittedRows(LiveFeed())
    events.begin("sc", 10)
    stored(events, 11)
    events._feed = listener
    stored(events, 12)
    assert listener.numbers == [12]


def test_rows_are_those_that_the_archive_gives(ground):
    nan = float("nan")
    rng = np.random.default_rng(3)
    powers = rng.normal(-60.0, 5.0, (3, 12)).astype(np.float32)
    powers[1, 4] = nan
    details = rng.normal(50.0, 3.0, (4, 3, 12)).astype(np.float32)
    details[1:3] = nan
    details[:, 2] = nan
    reported = []
    ground.storage.archive.listen(lambda *stored: reported.extend(stored_rows(*stored)))
    ground.append_rows(
        [ground.at(k) for k in (1, 2, 3)],
        powers,
        flags=((0,) * 12, None, (16, 0, 1 << 20) + (0,) * 9),
        details=CarrierDetails(*details),
        first_seq=1042,
    )
    ground.append_rows([ground.at(4)], powers[:1], source="sa-2", is_stale=np.array([True]))
    ground.append_rows([ground.at(6), ground.at(7)], powers[:2], source="sa-2", is_stale=np.array([True, False]))
    ground.storage.archive.listen(None)
    ground.append_rows([ground.at(5)], powers[:1])
    entries = ground.storage.archive.journal(ground.id, reported[0].number - 1, 6)
    assert repr(reported) == repr([entry.content for entry in entries])
    assert [(row.is_late, row.feeds_estimator) for row in reported] == [(False, True)] * 3 + [(True, False)] * 2 + [
        (False, False)
    ]


def test_a_listener_that_fails_does_not_hold_up_the_writer(ground, caplog):
    def fail(*_: object) -> None:
        message = "no"
        raise ValueError(message)

    ground.storage.archive.listen(fail)
    assert ground.append([1]).accepted == 1
    assert "publishing stored rows failed" in caplog.text


def test_a_row_is_told_before_anybody_follows_the_journal(ground, monkeypatch):
    monkeypatch.setattr("service.runtime.live.supervisor._POLL_S", 60.0)

    async def heard() -> list[int]:
        feed, events = LiveFeed(), ()
        with ground.supervised(feed=feed) as supervisor:
            subscription = feed.subscribe(ground.id)
            ground.append([1])
            await asyncio.to_thread(ground.settle, supervisor)
            # what is stored is told a moment later
            while not any(event.at_us == ground.at(1) for event in events if event.kind == "torque"):
                events, _ = await subscription.next_events(120.0)
            # nobody says that the journal has grown
            receipt = await asyncio.to_thread(ground.append, [2])
            events, _ = await subscription.next_events(120.0)
            assert receipt.first_number is not None
            return [event.cursor.number - receipt.first_number for event in events if event.kind == "measurement"]

    assert asyncio.run(heard()) == [0]


def entry(number: int) -> JournalEntry:
    """Return a journal entry with a row of powers."""
    return JournalEntry(number, Measurement(number, number, number, "sa-1", 1, np.zeros(2), None))


def row(number: int) -> AttitudeRow:
    """Return a result of a row."""
    return row_without_attitude(number, number, number, Method.PAPER, ("late",))


def reported(entries: list[JournalEntry], *rest: object) -> list[tuple[str, Cursor]]:
    """Return kind and cursor of each event of a batch."""
    found = result_events(entries[-1].number, entries, *rest)  # type: ignore[arg-type]
    return [(event.kind, event.cursor) for event in found]


def test_results_stand_under_their_sequences_and_the_newest_row():
    outcomes = [Outcome((row(5),), None), Outcome((row(6),), None)]
    assert reported([entry(5), entry(6)], outcomes, 10, 12) == [
        ("attitude", Cursor(6, 11)),
        ("attitude", Cursor(6, 12)),
    ]


def test_results_stored_before_are_not_published_under_sequences_of_others():
    alignment = JournalEntry(6, AlignmentSet(2))
    # two rows run again were stored by an earlier alignment; of three results only one is new
    outcomes = [Outcome((row(number),), None) for number in (5, 3, 4)]
    assert reported([entry(5), alignment], outcomes, 10, 11) == [("status", Cursor(6, 11))]


def test_alignment_is_news_of_its_own():
    assert reported([JournalEntry(6, AlignmentSet(2))], [], 10, 10) == [("status", Cursor(6, 10))]


def test_other_slow_inputs_are_silent():
    assert reported([JournalEntry(6, SpacecraftChange(None, 2))], [], 10, 10) == []  # type: ignore[arg-type]
