"""Publisher of rows: each once, in the order of the journal, by the writer or the follower."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest

from service.records.inputs import AlignmentSet
from service.records.journal import JournalEntry
from service.records.levels.measurement import BatchReceipt, CarrierDetails, MeasurementBatch
from service.runtime.live.live_feed import FeedEvent, LiveFeed
from service.runtime.live.row_publisher import RowPublisher, stored_rows


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
def events(listener):
    """Return news of a journal that is followed from behind number 10."""
    events = RowPublisher(listener)
    events.begin("sc", 10)
    return events


def batch(rows: int) -> MeasurementBatch:
    """Return a batch of some rows."""
    epochs_us = 1_000_000 * np.arange(rows)
    powers = np.zeros((rows, 2), dtype=np.float32)
    return MeasurementBatch(
        "sc", "sa-1", 1, 5, np.arange(rows), epochs_us, powers, (None,) * rows, np.zeros(rows, bool)
    )


def stored(events: RowPublisher, first: int, rows: int = 1, **changes: int) -> None:
    """Tell of a batch that was stored under the numbers from ``first`` on."""
    receipt = BatchReceipt(rows, 0, 0, (), first_number=first, feeds_estimator=True)
    events.stored(batch(rows), replace(receipt, **changes))  # type: ignore[arg-type]


def followed(events: RowPublisher, *numbers: int) -> None:
    """Come to entries of the journal."""
    (row,) = stored_rows(batch(1), BatchReceipt(1, 0, 0, (), first_number=1))
    events.followed("sc", [JournalEntry(number, replace(row, number=number)) for number in numbers])


def test_what_the_writer_told_is_not_told_again(events, listener):
    stored(events, 11, rows=2)
    stored(events, 13)
    followed(events, 11, 12, 13, 14)
    stored(events, 15)
    assert listener.numbers == [11, 12, 13, 14, 15]


def test_rows_behind_something_else_are_left_to_who_follows_the_journal(events, listener):
    # 11 is of another service, or no row: telling 12 now would hide it for good
    stored(events, 12)
    stored(events, 13)
    assert listener.numbers == []
    followed(events, 11, 12)
    events.followed("sc", [JournalEntry(13, AlignmentSet(1))])
    stored(events, 14)
    assert listener.numbers == [11, 12, 14]


def test_who_follows_comes_first(events, listener):
    followed(events, 11)
    stored(events, 11)
    assert listener.numbers == [11]


def test_a_journal_that_nobody_follows_yet_is_not_told(events, listener):
    fresh = RowPublisher(listener)
    stored(fresh, 1)
    assert listener.numbers == []


def test_following_anew_from_further_back_tells_nothing_twice(events, listener):
    stored(events, 11)
    events.begin("sc", 10)
    followed(events, 11, 12)
    assert listener.numbers == [11, 12]


@pytest.mark.parametrize(
    "changes",
    [{"accepted": 1, "duplicates": 1}, {"accepted": 0, "first_number": None}],
    ids=["a duplicate among them", "nothing stored"],
)
def test_batches_in_part_are_left_to_who_follows_the_journal(events, listener, changes):
    stored(events, 11, rows=2, **changes)
    assert listener.numbers == []


def test_a_backlog_is_left_to_who_follows_the_journal(events, listener):
    stored(events, 11, rows=17)
    assert listener.numbers == []


def test_rows_without_a_listener_count_as_told(listener):
    events = RowPublisher(LiveFeed())
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
