"""Rows kept for the followers of the journal: the next ones, whole, once, within the bound."""

import asyncio
from contextlib import closing

import numpy as np
import pytest

import service.runtime.live.row_cache as module
import service.runtime.live.supervisor as supervisor_module
from service.records.journal import JournalEntry
from service.records.levels.measurement import BatchReceipt, Measurement, MeasurementBatch
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.row_cache import FreshRows
from service.runtime.live.row_publisher import RowPublisher


@pytest.fixture
def fresh():
    return FreshRows()


def store(fresh: FreshRows, first: int | None, rows: int, *, accepted: int | None = None, sc: str = "sc") -> None:
    """Keep a batch that was stored under the numbers from ``first`` on."""
    powers = np.zeros((rows, 2), dtype=np.float32)
    positions = np.arange(rows)
    batch = MeasurementBatch(
        sc, "sa-1", 1, 5, positions, 1000 * positions, powers, (None,) * rows, np.zeros(rows, bool)
    )
    fresh.stored(batch, BatchReceipt(rows if accepted is None else accepted, 0, 0, (), first_number=first))


def after(fresh: FreshRows, number: int, limit: int = 100) -> list[int]:
    """Return the journal numbers that follow."""
    entries = fresh.after("sc", number, limit)
    assert all(entry.number == entry.content.number for entry in entries)
    return [entry.number for entry in entries]


def test_what_follows_is_given_once_and_in_order(fresh):
    store(fresh, 11, 2)
    store(fresh, 13, 3)
    store(fresh, 1, 5, sc="other")
    assert after(fresh, 10) == [11, 12, 13, 14, 15]
    assert after(fresh, 10) == after(fresh, 15) == []


def test_rows_that_a_listener_was_given_are_not_built_again(fresh):
    publisher = RowPublisher(feed := LiveFeed())
    publisher.begin("sc", 10)
    loop = asyncio.new_event_loop()
    with closing(loop):
        loop.run_until_complete(_subscribed(feed))
        batch = MeasurementBatch(
            "sc", "sa-1", 1, 5, np.arange(2), np.arange(2), np.zeros((2, 2), np.float32), (None,) * 2, np.zeros(2, bool)
        )
        receipt = BatchReceipt(2, 0, 0, (), first_number=11)
        published = publisher.stored(batch, receipt)
        fresh.stored(batch, receipt, published)
    assert published is not None
    assert [id(entry.content) for entry in fresh.after("sc", 10, 100)] == [id(row) for row in published]


async def _subscribed(feed: LiveFeed) -> None:
    feed.subscribe("sc")


def test_nothing_behind_a_gap_is_given_before_the_gap_is_read_elsewhere(fresh):
    store(fresh, 11, 2)
    # 13 is a slow input, or a row of another service
    store(fresh, 14, 2)
    assert after(fresh, 10) == [11, 12]
    assert after(fresh, 12) == []
    assert after(fresh, 13) == [14, 15]


def test_rows_that_were_read_elsewhere_are_left_out(fresh):
    store(fresh, 11, 2)
    store(fresh, 13, 4)
    assert after(fresh, 14) == [15, 16]


def test_a_limit_ends_with_the_batch_that_reaches_it(fresh):
    for first in (11, 14, 17):
        store(fresh, first, 3)
    assert after(fresh, 10, limit=4) == [11, 12, 13, 14, 15, 16]
    assert after(fresh, 16, limit=4) == [17, 18, 19]


@pytest.mark.parametrize(("first", "accepted"), [(11, 1), (None, 0)], ids=["a part", "nothing"])
def test_batches_that_were_not_stored_whole_are_not_kept(fresh, first, accepted):
    store(fresh, first, 2, accepted=accepted)
    assert after(fresh, 10) == []


def test_the_oldest_go_when_there_are_too_many(fresh, monkeypatch):
    monkeypatch.setattr(module, "_KEPT_ROWS", 5)
    store(fresh, 1, 6)
    for first in (7, 9, 11):
        store(fresh, first, 2)
    assert after(fresh, 0) == after(fresh, 6) == []
    assert after(fresh, 8) == [9, 10, 11, 12]


def test_the_chain_is_fed_with_the_rows_that_were_just_written(ground, monkeypatch, wait):
    read: list[object] = []
    archive = ground.storage.archive
    original = archive.journal

    def journal(*position: object) -> list[JournalEntry]:
        entries: list[JournalEntry] = original(*position)
        read.extend(entry.content for entry in entries)
        return entries

    are_read_back = []
    # a look that is under way between commit and news finds the rows in the journal, which is as good
    monkeypatch.setattr(supervisor_module, "_POLL_S", 60.0)
    with ground.supervised() as supervisor:
        ground.settle(supervisor)
        monkeypatch.setattr(archive, "journal", journal)
        for first in range(1, 31, 3):
            read.clear()
            receipt = ground.append(range(first, first + 3))
            supervisor.notify(ground.id, receipt.first_number + 2)
            wait(ground.is_settled)
            # commands that count as applied are slow inputs, behind the rows
            are_read_back.append(any(isinstance(content, Measurement) for content in read))
    assert not all(are_read_back)
    assert len(ground.rows()) == 30
