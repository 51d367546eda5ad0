"""Two services on one archive: one estimates, the other tells what that one stored and takes over when it ends."""

import asyncio
import time
from contextlib import contextmanager
from unittest.mock import Mock, patch

import pytest

import service.runtime.live.leadership as leading_module
import service.runtime.live.supervisor as supervisor_module
from db.storage import SqlStorage
from service.errors import StorageError
from service.runtime.alarms.alarm_service import AlarmService
from service.runtime.live.leadership import Leading
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.supervisor import Supervisor


@pytest.fixture(autouse=True)
def _often():
    """Look often, so that tests need not wait."""
    with patch.object(leading_module, "POLL_S", 0.02), patch.object(supervisor_module, "_POLL_S", 0.02):
        yield


@contextmanager
def service_on(ground, feed=None):
    """Run what estimates in a service of its own on the archive of a ground; give its lead and its supervisor."""
    storage = SqlStorage(str(ground.storage._database.engines.write.url))
    leading = Leading(storage.leases)
    supervisor = Supervisor(storage, feed or LiveFeed(), ground.config, turn=leading.term)
    leading.start()
    supervisor.start()
    try:
        yield leading, supervisor
    finally:
        supervisor.stop()
        leading.stop()
        storage.close()


def rows_of(ground):
    """Return results without journal numbers, which applied commands shift about."""
    return repr([(row.epoch_us, row.attitude_deg, row.sigma_deg, row.inhibitions) for row in ground.rows()])


def test_rows_are_those_of_one_service_whichever_estimates(new_ground, wait):
    alone, shared = new_ground(), new_ground()
    for ground in (alone, shared):
        ground.align()
    with alone.supervised() as supervisor:
        alone.append(range(1, 61))
        alone.settle(supervisor)
    with service_on(shared) as (second_to_last, _), service_on(shared) as (standing_by, _):
        assert (second_to_last.term(shared.id), standing_by.term(shared.id)) == (1, 0)
        # nobody tells the one that leads of rows that came in elsewhere
        shared.append(range(1, 31))
        wait(shared.is_settled)
        second_to_last.stop()
        wait(lambda: standing_by.term(shared.id) == 1)
        shared.append(range(31, 61))
        wait(shared.is_settled)
    assert rows_of(shared) == rows_of(alone)
    commands = shared.commands()
    assert len({command.epoch_us for command in commands}) == len(commands) == 60


def test_a_turn_that_was_lost_begins_anew_and_doubles_nothing(new_ground, wait):
    ground = new_ground()
    ground.align()
    leases = Mock()
    leases.wait.side_effect = lambda limit_s: time.sleep(limit_s) or frozenset()
    leases.ended.return_value = 0
    leases.poll.return_value = lambda _: 1
    leading = Leading(leases)
    supervisor = Supervisor(ground.storage, LiveFeed(), ground.config, turn=leading.term)
    begun = []
    leading.start([lambda: begun.append(1)])
    supervisor.start()
    try:
        ground.append(range(1, 11))
        wait(ground.is_settled)
        leases.poll.return_value = lambda _: 0
        wait(lambda: leading.term(ground.id) == 0)
        ground.append(range(11, 21))
        assert len(ground.rows()) == 10
        leases.poll.return_value = lambda _: 2
        wait(lambda: leading.term(ground.id) == 2)
        wait(ground.is_settled)
    finally:
        supervisor.stop()
        leading.stop()
    assert len(begun) == 2
    assert [row.epoch_us for row in ground.rows()] == [ground.at(minute) for minute in range(1, 21)]


def test_streams_of_a_service_that_stands_by_hear_what_the_other_stored(new_ground, wait):
    ground, feed = new_ground(), LiveFeed()
    ground.align()

    async def heard(supervisor):
        subscription = feed.subscribe(ground.id)
        # from its first look on it tells what is stored; before, streams find it in the archive
        await asyncio.to_thread(wait, lambda: ground.id in supervisor._relay._positions)
        await asyncio.to_thread(ground.append, range(1, 4))
        await asyncio.to_thread(wait, ground.is_settled)
        newest = ground.storage.archive.head(ground.id).result_sequence
        events = []
        while not any(event.kind == "status" and event.cursor.sequence == newest >= 6 for event in events):
            events += (await subscription.next_events(120.0))[0]
        return events

    with service_on(ground), service_on(ground, feed) as (_, standing_by):
        events = asyncio.run(heard(standing_by))
    rows = [event.content.epoch_us for event in events if event.kind == "measurement"]
    assert rows == [ground.at(minute) for minute in range(1, 4)]
    assert {event.content for event in events if event.kind == "status"} == {None}


def test_alarms_are_the_business_of_the_service_that_leads(new_ground):
    ground, turn = new_ground(), Mock(return_value=0)
    desk = AlarmService(ground.storage, ground.clock, LiveFeed(), {}, Mock(), turn=turn)
    alarms = Mock(wraps=ground.storage.alarms)
    alarms.alarm = Mock(return_value=Mock(spacecraft_id=ground.id))
    with patch.object(ground.storage, "alarms", alarms), pytest.raises(StorageError) as caught:
        desk.acknowledge(1, "anna", "")
    assert caught.value.code == "lease.elsewhere"
    desk._check_clock()
    assert not alarms.save.called
    assert not alarms.save_memory.called
