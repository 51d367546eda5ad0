"""Live feed: every subscriber has what it kept up with, and is told what it lost."""

import asyncio
import threading
from collections import Counter
from types import SimpleNamespace

import pytest

from service.runtime.live.live_feed import Cursor, DroppedRows, FeedEvent, LiveFeed

pytestmark = pytest.mark.anyio


@pytest.fixture
def make_row():
    """Return a maker of contents that know nothing but their epoch."""
    return lambda epoch_us: SimpleNamespace(epoch_us=epoch_us)


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


async def test_what_was_dropped_is_told_by_kind_and_span(make_row):
    feed = LiveFeed(capacity=1)
    slow = feed.subscribe("a")
    rows = tuple(FeedEvent("measurement", Cursor(k, 0), make_row(1_000_000 * k)) for k in (3, 1, 2))
    feed.publish("a", rows)
    await asyncio.sleep(0)
    found, dropped = await slow.next_events(1.0)
    assert numbers(found) == [2]
    assert dropped == DroppedRows(Counter({"measurement": 2}), 1_000_000, 3_000_000)
    assert dropped
    assert not DroppedRows()
