"""The supervisor over a real archive: whatever happens on the way, the rows are those of an undisturbed run."""

import asyncio
import random
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import count
from unittest.mock import patch

import numpy as np
import pytest
from alarm_rig import CARRIERS, INERTIA
from busy_station import BOTH, SC, morning, text, wait_for
from storage_parts import with_part

import service.runtime.live.supervisor as supervisor_module
from bench import plain_batch
from db.storage import SqlStorage
from service.errors import StorageError
from service.pipeline.config import ChainConfig
from service.pipeline.estimation.paper.runner import PaperRunner
from service.records.catalogue import Release, Site, Spacecraft
from service.records.inputs import Operation
from service.records.levels.attitude import AppliedCommand, Status
from service.runtime.live import journal_consumer
from service.runtime.live import supervisor as live
from service.runtime.live.journal_consumer import ChainRestarts
from service.runtime.live.live_feed import LiveFeed


def unnumbered(results):
    """Return results without journal numbers, which applied commands shift about."""
    return repr([replace(result, number=0) for result in results])


def test_a_day_is_tracked_from_the_archive_alone(ground):
    with ground.supervised() as supervisor:
        ground.append(range(1, 241))
        ground.settle(supervisor)
    rows = ground.rows()
    assert [row.epoch_us for row in rows] == [ground.at(minute) for minute in range(1, 241)]
    assert all(row.control_allowed for row in rows[20:])
    estimate = np.array([row.attitude_deg for row in rows[20:]])
    # the mean of fifteen rows is seven minutes old
    truth = ground.angles(range(21 - 7, 241 - 7))
    error = estimate - truth
    # 0.05 dB of noise over twelve carriers and fifteen rows, references of thirty: 0.06 / 0.01 / 0.015 deg, three sigma
    np.testing.assert_array_less(np.sqrt(np.mean(error**2, axis=0)), [0.2, 0.03, 0.04])
    assert len(ground.commands()) == 240
    applied = [e for e in ground.storage.archive.journal(ground.id, 0, 10_000) if isinstance(e.content, AppliedCommand)]
    assert len(applied) == sum(command.control_allowed for command in ground.commands()) > 200


def test_a_stop_before_all_is_consumed_loses_nothing(new_ground):
    through, broken = new_ground(), new_ground()
    for ground in (through, broken):
        ground.align()
        ground.append(range(1, 121))
    with through.supervised() as supervisor:
        through.settle(supervisor)
    with patch.object(supervisor_module, "_ENTRIES_AT_ONCE", 16):
        for _ in range(3):
            with broken.supervised() as supervisor:
                supervisor.notify(broken.id)
        with broken.supervised() as supervisor:
            broken.settle(supervisor)
    assert unnumbered(broken.rows()) == unnumbered(through.rows())


# ---- catching up ----------------------------------------------------------------------------------------------------
def test_rows_stored_before_the_alignment_are_caught_up_with(new_ground):
    ground = new_ground()
    with ground.supervised() as supervisor:
        ground.append(range(1, 61))
        ground.settle(supervisor)
        assert {row.inhibitions for row in ground.rows()} == {("not_aligned",)}
        ground.align()
        ground.settle(supervisor)
        ground.append(range(61, 81))
        ground.settle(supervisor)
    rows = ground.rows()
    assert len(rows) == 80
    assert all("catch_up" in row.inhibitions for row in rows[:60])
    assert all(row.status is Status.ACQUIRED for row in rows[8:])
    assert all(row.inhibitions == () for row in rows[60:])
    assert ground.storage.results.pending(ground.id, [rows[0].method]) == 0
    assert not any(command.schedule for command in ground.commands()[:60])
    assert ground.commands()[-1].control_allowed


def test_a_second_alignment_keeps_earlier_rows_and_starts_the_means_anew(ground):
    with ground.supervised() as supervisor:
        ground.append(range(1, 61))
        ground.settle(supervisor)
        before = repr(ground.rows(stop=61))
        second = ground.align()
        ground.settle(supervisor)
        assert repr(ground.rows(stop=61)) == before
        ground.append(range(61, 91))
        ground.settle(supervisor)
    assert repr(ground.rows(stop=61)) == before
    # rows caught up with fill the means: the first new row is settled
    assert {row.alignment_id for row in ground.rows(start=61)} == {second.id}
    assert all(row.inhibitions == () for row in ground.rows(start=61))


def test_an_alignment_at_the_same_epoch_keeps_rows_and_a_replay_computes_them_again(ground):
    (former,) = ground.storage.results.alignments(ground.id)
    with ground.supervised() as supervisor:
        ground.append(range(1, 61))
        ground.settle(supervisor)
        before = repr(ground.rows(stop=61))
        again = ground.align()
        # sixty, and the one at the end of the alignment window
        assert ground.storage.results.rows_after(ground.id, again) == (0, 61)
        ground.settle(supervisor)
        ground.append(range(61, 71))
        ground.settle(supervisor)
    assert (again.epoch_us, again.id) == (former.epoch_us, former.id + 1)
    assert repr(ground.rows(stop=61)) == before
    assert {row.alignment_id for row in ground.rows(stop=61)} == {former.id}
    assert {row.alignment_id for row in ground.rows(start=61)} == {again.id}
    rows = ground.rows(ground.replay(1, 61, alignment_id=again.id, order="epoch"))
    assert len(rows) == 60
    assert {row.alignment_id for row in rows} == {again.id}


# ---- faults ---------------------------------------------------------------------------------------------------------
def failing(storage, part, method, calls):
    """Return a storage one of whose methods fails at some of its calls."""
    found, numbers = getattr(getattr(storage, part), method), count(1)

    def guarded(*arguments):
        if next(numbers) in calls:
            raise StorageError("storage.unavailable", "the disk is full; make room")
        return found(*arguments)

    return with_part(storage, part, **{method: guarded})


@pytest.mark.parametrize(
    ("part", "method", "calls"),
    [
        ("results", "submit_outcomes", {1}),
        ("results", "submit_outcomes", {2, 3}),
        ("archive", "journal", {2}),
        ("archive", "measurements_after", {1}),
        ("catalogue", "plan", {1}),
    ],
)
def test_a_storage_that_fails_delays_rows_and_loses_none(new_ground, caplog, part, method, calls):
    plain, faulty = new_ground(), new_ground()
    for ground in (plain, faulty):
        ground.align()
    with plain.supervised() as supervisor:
        plain.append(range(1, 61))
        plain.settle(supervisor)
    with (
        patch.object(supervisor_module, "_RETRY_S", 0.02),
        patch.object(supervisor_module, "_ENTRIES_AT_ONCE", 400),
        faulty.supervised(failing(faulty.storage, part, method, calls)) as supervisor,
    ):
        faulty.append(range(1, 61))
        faulty.settle(supervisor)
    assert unnumbered(faulty.rows()) == unnumbered(plain.rows())
    assert unnumbered(faulty.commands()) == unnumbered(plain.commands())
    assert "its state is rebuilt from the archive" in caplog.text


def test_a_row_that_breaks_the_computation_says_so_and_the_stream_goes_on(ground, caplog):
    plain = PaperRunner.steps

    def breaking(runner, measurements, *known, **options):
        if any(each.epoch_us == ground.at(30) for each in measurements):
            raise FloatingPointError("overflow")
        return plain(runner, measurements, *known, **options)

    with patch.object(PaperRunner, "steps", breaking), ground.supervised() as supervisor:
        ground.append(range(1, 41))
        ground.settle(supervisor)
    rows = {row.epoch_us: row for row in ground.rows()}
    assert rows[ground.at(30)].inhibitions == ("internal_error",)
    assert not rows[ground.at(30)].control_allowed
    assert rows[ground.at(31)].control_allowed
    assert "failed" in caplog.text


# ---- what others see ------------------------------------------------------------------------------------------------
@pytest.mark.anyio
async def test_the_feed_tells_every_row_and_result_once_in_order(ground):
    feed = LiveFeed()
    subscription = feed.subscribe(ground.id)
    with ground.supervised(feed=feed) as supervisor:
        await asyncio.to_thread(ground.settle, supervisor)
        await subscription.next_events(0.2)
        for first in range(1, 61, 20):
            ground.append(range(first, first + 20))
            await asyncio.to_thread(ground.settle, supervisor)
    events = []
    while found := (await subscription.next_events(0.2))[0]:
        events += found
    rows = [event for event in events if event.kind == "measurement"]
    assert [event.content.epoch_us for event in rows] == [ground.at(minute) for minute in range(1, 61)]
    # the row at the alignment may be told after the first look
    results = [
        event for event in events if event.kind in ("attitude", "torque") and event.content.epoch_us > ground.at(0)
    ]
    sequences = [event.cursor.sequence for event in results]
    assert sequences == list(range(sequences[0], sequences[0] + 120))
    stored = dict(ground.storage.results.results_after(ground.id, sequences[0] - 1, 1000))
    assert all(repr(stored[event.cursor.sequence]) == repr(event.content) for event in results)


@pytest.mark.anyio
async def test_a_new_alignment_is_told_as_a_status(ground):
    feed, events = LiveFeed(), ()
    with ground.supervised(feed=feed) as supervisor:
        subscription = feed.subscribe(ground.id)
        ground.append(range(1, 31))
        await asyncio.to_thread(ground.settle, supervisor)
        # what is stored is told a moment later
        while not any(event.at_us == ground.at(30) for event in events if event.kind == "torque"):
            events = (await subscription.next_events(120.0))[0]
        ground.align()
        await asyncio.to_thread(ground.settle, supervisor)
        events, missed = await subscription.next_events(120.0)
    # its rows had their results before, so there is nothing new but the alignment itself
    assert ([event.kind for event in events], bool(missed)) == (["status"], False)


def test_states_of_carriers_are_those_of_the_newest_row(ground):
    with ground.supervised() as supervisor:
        assert supervisor.carrier_states("nobody") is None
        ground.append(range(1, 21))
        ground.settle(supervisor)
        measurement, states = supervisor.carrier_states(ground.id)
    assert measurement.epoch_us == ground.at(20)
    assert [state.carrier for state in states] == list(ground.payload.ids)
    assert {state.state for state in states} == {"used"}


def test_a_question_about_the_newest_row_does_not_wait_for_a_long_step(ground):
    with ground.supervised() as supervisor:
        ground.append(range(1, 3))
        ground.settle(supervisor)
        with ThreadPoolExecutor(1) as asking, supervisor._followers[ground.id].lock:
            assert asking.submit(supervisor.carrier_states, ground.id).result(60) is None
            assert asking.submit(supervisor.is_disagreeing, ground.id).result(60) is False
        assert supervisor.carrier_states(ground.id) is not None


def test_released_in_two_steps_nothing_counts_as_applied(ground):
    record = ground.storage.catalogue.spacecraft(ground.id)
    two_step = replace(record, control=replace(record.control, release=Release.TWO_STEP))
    ground.storage.catalogue.replace_spacecraft(two_step)
    with ground.supervised() as supervisor:
        ground.append(range(1, 41))
        ground.settle(supervisor)
    entries = ground.storage.archive.journal(ground.id, 0, 10_000)
    assert not any(isinstance(entry.content, AppliedCommand) for entry in entries)
    assert ground.commands()[-1].control_allowed


def test_a_declared_operation_holds_control_in_the_live_run(ground):
    operation = Operation(0, "eclipse", ground.at(30), ground.at(35), inhibit_control=True)
    ground.storage.archive.add_operation(ground.id, operation)
    with ground.supervised() as supervisor:
        ground.append(range(1, 41))
        ground.settle(supervisor)
    held = [row.epoch_us for row in ground.rows(start=21) if "operation" in row.inhibitions]
    assert held == [ground.at(minute) for minute in range(30, 35)]


def test_a_supervisor_that_was_never_started_can_be_stopped(ground):
    supervisor_module.Supervisor(ground.storage, LiveFeed(), ground.config).stop()
    assert not ground.rows()


def test_methods_of_a_spacecraft_nobody_follows_do_not_disagree(ground):
    with ground.supervised() as supervisor:
        assert supervisor.is_disagreeing("nobody") is False
        ground.append(range(1, 3))
        ground.settle(supervisor)
        # one method alone has nobody to disagree with
        assert supervisor.is_disagreeing(ground.synthetic.SC) is False


def test_a_spacecraft_that_is_deleted_is_followed_no_more(new_ground, wait, caplog):
    """Nothing is tried again and nothing is logged as a fault."""
    ground = new_ground()
    ground.storage.catalogue.add_spacecraft(replace(ground.storage.catalogue.spacecraft(ground.id), id="empty"))
    with ground.supervised() as supervisor:
        wait(lambda: "empty" in supervisor._followers)
        ground.storage.catalogue.delete_spacecraft("empty")
        supervisor.notify("empty")
        wait(lambda: "empty" not in supervisor._followers)
        ground.settle(supervisor)
    assert "its state is rebuilt" not in caplog.text


def test_a_chain_that_is_brought_back_is_catching_up_until_it_stands(ground):
    gate = threading.Event()

    def slow(restarts, spacecraft_id, consumed_number):
        assert gate.wait(60)
        return chain(restarts, spacecraft_id, consumed_number)

    with ground.supervised() as supervisor:
        # nothing is stored yet: there is nothing to be behind of
        assert not supervisor.is_catching_up(ground.id)
        ground.append(range(1, 20))
        ground.settle(supervisor)
        assert not supervisor.is_catching_up(ground.id)
    chain = ChainRestarts.chain
    with patch.object(ChainRestarts, "chain", slow), ground.supervised() as supervisor:
        assert supervisor.is_catching_up(ground.id)
        ground.append(range(20, 30))
        gate.set()
        ground.settle(supervisor)
        assert not supervisor.is_catching_up(ground.id)
    assert not supervisor.is_catching_up(ground.id), "a service that has stopped brings nothing back"


MINUTE_US = 60_000_000


def live_and_die(station, rng):
    """Run a service until it is killed at one of its commits or there is nothing left; return whether it was killed."""
    results, saves_left, is_stored = station.storage.results, rng.randint(1, 25), rng.random() < 0.5
    is_dead = False

    def dying(save):
        def saved(*arguments):
            nonlocal saves_left, is_dead
            saves_left -= 1
            stored = save(*arguments) if saves_left > 0 or (saves_left == 0 and is_stored) else None
            if saves_left <= 0:
                # from then on it stores nothing
                is_dead = True
                raise StorageError("storage.unavailable", "this process is killed")
            return stored

        return saved

    saves = {name: dying(getattr(results, name)) for name in ("submit_outcomes", "save_outcomes")}
    service = live.Supervisor(with_part(station.storage, "results", **saves), LiveFeed(), ChainConfig())
    service.start()
    service.notify(SC)
    wait_for(lambda: is_dead or station.is_settled())
    # no last words either
    is_killed, saves_left, is_stored = is_dead, 0, False
    service.stop()
    return is_killed


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30))
def test_the_rows_are_those_of_a_service_that_was_never_killed(
    seed, lived_archive, opened_archive, new_station, monkeypatch
):
    print(f"seed {seed}")
    through, broken, rng = new_station(lived_archive), new_station(opened_archive), random.Random(seed)
    # every row is a commit of its own; checkpoints are close or far
    monkeypatch.setattr(live, "_STEP_S", 0.0)
    monkeypatch.setattr(live, "_ENTRIES_AT_ONCE", 1)
    monkeypatch.setattr(live, "PERIOD_US", rng.choice([1, 7, 60]) * MINUTE_US)
    monkeypatch.setattr(live, "_RETRY_S", 60.0)
    kills = 0
    for _ in morning(broken):
        while live_and_die(broken, rng):
            kills += 1
    assert kills > 5
    for method in BOTH:
        assert text(broken.rows(method)) == text(through.rows(method))
    assert text(broken.commands()) == text(through.commands())
    sequences = [sequence for sequence, _ in broken.storage.results.results_after(SC, 0, 100_000)]
    assert sequences == np.arange(1, 1 + len(sequences)).tolist()


def test_spacecraft_that_wait_have_their_turns_by_blocks(tmp_path, monkeypatch):
    storage, names = SqlStorage(f"sqlite:///{tmp_path / 'soo.db'}"), ("a", "b", "c")
    storage.prepare()
    for name in names:
        storage.catalogue.add_spacecraft(Spacecraft(name, name, 90.0, Site(55.0, 38.0), INERTIA, 0.05))
        storage.catalogue.put_plan(name, CARRIERS, "sha")
        epochs_us = MINUTE_US * np.arange(1, 21)
        rows = plain_batch(name, int(epochs_us[-1]), epochs_us, np.full((20, len(CARRIERS)), -42.0))
        assert storage.archive.append_measurements(rows).result(timeout=120).accepted == 20
    # a block is one entry
    monkeypatch.setattr(live, "_BLOCK_S", 0.0)
    monkeypatch.setattr(journal_consumer, "_LIVE_ROWS", 1)
    turns = []

    def submit_outcomes(name, *arguments):
        turns.append(name)
        return storage.results.submit_outcomes(name, *arguments)

    service = live.Supervisor(with_part(storage, "results", submit_outcomes=submit_outcomes), LiveFeed(), ChainConfig())
    service.start()
    try:
        wait_for(lambda: all(each.consumed_number == each.newest_number for each in storage.archive.heads().values()))
    finally:
        service.stop()
        storage.close()
    rounds = list(zip(*[iter(turns)] * 3, strict=True))
    assert len(rounds) > 20
    assert all(set(each) == set(names) for each in rounds)
