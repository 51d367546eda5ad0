"""Restarts from checkpoints: whatever was stored of the state, the rows are those of an undisturbed run."""

import random

import numpy as np
import pytest
from busy_station import BOTH, SC, at, morning, text, wait_for
from sqlalchemy import update

from db.results import jobs
from db.results.jobs import LATEST
from db.tables import checkpoint as table
from service.pipeline.checkpoints import fingerprint
from service.pipeline.config import ChainConfig, RobustConfig
from service.ports.archive import LIVE
from service.records.storage import Checkpoint
from service.runtime.jobs import replay as replay_run
from service.runtime.live import journal_consumer, supervisor

MINUTE_US, DAY_US = 60_000_000, 86_400_000_000
FITS = fingerprint(ChainConfig())


def kept(station, until=1 << 62):
    return list(station.storage.results.checkpoints(SC, FITS, until))


def run_sql(station, statement):
    """Change checkpoints of a station as nobody does."""
    station.storage._database.write(lambda connection: connection.execute(statement))


@pytest.fixture
def often(monkeypatch):
    """Checkpoints after each minute of data, and services that end as if they were killed."""
    monkeypatch.setattr(supervisor, "PERIOD_US", MINUTE_US)
    monkeypatch.setattr(supervisor.Supervisor, "_keep_states", lambda _self: None)


@pytest.fixture
def steps(monkeypatch):
    """Numbers of the journal's entries that restarts consume again."""
    again = []

    def noted(chain, entry, *rest):
        again.append(entry.number)
        return consume(chain, entry, *rest)

    consume = journal_consumer.consume
    monkeypatch.setattr(journal_consumer, "consume", noted)
    return again


def lived_again(station, pieces=None):
    """Live a morning, or what is left of one, with a new service after each of its pieces."""
    pieces, is_over = pieces or morning(station), False
    while not is_over:
        with station.supervised() as settle:
            is_over = next(pieces, pieces) is pieces
            settle()


def assert_same(station, through):
    for method in BOTH:
        assert text(station.rows(method)) == text(through.rows(method))
    assert text(station.commands()) == text(through.commands())


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_services_that_are_killed_anywhere_change_no_row(
    seed, lived_archive, opened_archive, new_station, often, monkeypatch
):
    through, broken, rng = new_station(lived_archive), new_station(opened_archive), random.Random(seed)
    print(f"seed {seed}")
    # what is stored in one go ends anywhere
    monkeypatch.setattr(supervisor, "_STEP_S", 0.0)
    monkeypatch.setattr(supervisor, "_ENTRIES_AT_ONCE", rng.randint(1, 9))
    lived_again(broken)
    assert len(kept(broken)) >= LATEST
    assert_same(broken, through)


def test_a_clean_stop_leaves_nothing_to_be_consumed_again(lived_archive, opened_archive, new_station, steps):
    through, broken = new_station(lived_archive), new_station(opened_archive)
    lived_again(broken)
    assert_same(broken, through)
    # the first piece aligns; its checkpoint is taken at the stop, and so are those of the others
    assert steps == []
    with broken.supervised() as settle:
        broken.send(range(140, 142), source="sa-2")
        settle()
    assert steps == []
    assert broken.storage.archive.head(SC).consumed_number - kept(broken)[0].number == 0


def test_a_chain_that_was_computed_again_is_stored_at_the_next_stop(busy, steps):
    run_sql(busy, table.delete())
    for again in (True, False):
        with busy.supervised():
            busy.supervisor.notify(SC)
            wait_for(lambda: busy.supervisor.carrier_states(SC) is not None)
        assert bool(steps) is again
        steps.clear()


def test_carriers_are_known_before_the_next_row(busy):
    def states():
        with busy.supervised():
            busy.supervisor.notify(SC)
            wait_for(lambda: busy.supervisor.carrier_states(SC) is not None)
            return busy.supervisor.carrier_states(SC)

    with busy.supervised() as settle:
        busy.send(range(140, 142), source="sa-2")
        settle()
        before = busy.supervisor.carrier_states(SC)
    assert kept(busy)[0].epoch_us == at(141)
    assert repr(states()) == repr(before)


DAMAGES = {
    "cut off": lambda content: {"content": content[: len(content) // 2]},
    "a bit flipped, checksum of before": lambda content: {"content": bytes([content[0] ^ 1]) + content[1:]},
    "another layout": lambda _content: {"fingerprint": "0/of-a-newer-version/numpy/1"},
    "ahead of the journal": lambda _content: {"number": 1 << 40},
    "no state at all, with its checksum": None,
}


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_checkpoint_that_does_not_fit_is_left_out(damage, lived_archive, opened_archive, new_station, steps, caplog):
    through, broken = new_station(lived_archive), new_station(opened_archive)
    pieces = morning(broken)
    for _ in range(3):
        with broken.supervised() as settle:
            next(pieces)
            settle()
    newest = kept(broken)[0]
    if (change := DAMAGES[damage]) is None:
        save = broken.storage.results.save_outcomes
        nonsense = Checkpoint(newest.number, newest.epoch_us, FITS, b"PK\x03\x04 nonsense")
        save(SC, LIVE, [], newest.number, newest.epoch_us, nonsense)
    else:
        run_sql(broken, table.delete().where(table.c.number != newest.number))
        run_sql(broken, update(table).values(**change(newest.content)))
        assert [one for one in kept(broken, newest.number) if one == newest] == []
    lived_again(broken, pieces)
    assert_same(broken, through)
    assert steps, "the state was computed again"
    assert ("cannot be read" in caplog.text) is (change is None)


def test_a_restart_says_how_far_it_is_and_ends_when_the_service_stops(busy, monkeypatch):
    monkeypatch.setattr(journal_consumer, "_ENTRIES_AT_ONCE", 20)
    run_sql(busy, table.delete())
    consumed, seen = busy.storage.archive.head(SC).consumed_number, []

    def stops():
        seen.append(restarts.under_way)
        return len(seen) == 3

    restarts = journal_consumer.ChainRestarts(busy.storage, ChainConfig(), stops)
    assert restarts.chain(SC, consumed) is None
    assert restarts.under_way is None
    assert [one.entries_left for one in seen] == [seen[0].entries_left - 20 * k for k in range(3)]
    assert seen[0].seconds_left is None
    assert seen[2].seconds_left > 0.0
    chain, _ = journal_consumer.ChainRestarts(busy.storage, ChainConfig(), lambda: False).chain(SC, consumed)
    assert chain.is_running


@pytest.mark.slow
def test_a_replay_goes_on_from_the_newest_state_before_its_span(opened_archive, new_station, often, monkeypatch):
    monkeypatch.setattr(jobs, "LATEST", 1000)
    monkeypatch.setattr(supervisor, "_STEP_S", 0.0)
    monkeypatch.setattr(supervisor, "_ENTRIES_AT_ONCE", 5)
    station, begun = new_station(opened_archive), []

    def noted(*order):
        begun.append(journal_consumer.restored_checkpoint(*order))
        return begun[-1]

    monkeypatch.setattr(replay_run, "restored_checkpoint", noted)
    with station.supervised() as settle:
        for _ in morning(station):
            settle()
    consumed, consume, consume_rows = [], replay_run.consume, replay_run.consume_rows

    def counted(chain, entry, *rest):
        consumed.append(entry.number)
        return consume(chain, entry, *rest)

    def counted_rows(chain, rows):
        consumed.extend(row.number for row in rows)
        return consume_rows(chain, rows)

    monkeypatch.setattr(replay_run, "consume", counted)
    monkeypatch.setattr(replay_run, "consume_rows", counted_rows)
    newest_number = station.storage.archive.head(SC).newest_number
    for start, stop in ((30, 58), (75, 79), (100, 140), (125, 140)):
        consumed.clear()
        version = station.replay(start, stop)
        # a late row, or an alignment, of the span may stand at the end of the journal
        assert (consumed[-1] < newest_number - 100) is (stop < 80)
        for method in BOTH:
            assert text(station.rows(method, version)) == text(station.rows(method, start=start, stop=stop))
            assert station.carriers(method, version, start, stop) == station.carriers(method, LIVE, start, stop) != {}
    assert None not in begun
    numbers = [one.number for one in begun]
    assert numbers == sorted(set(numbers))
    station.replay(125, 140, alignment_id=1)
    station.replay(125, 140, calibration_id=1)
    assert len(begun) == 4, "other documents hold in none of the states"


def test_the_latest_and_one_of_each_day_are_kept(busy):
    first = busy.storage.archive.head(SC).consumed_number
    epochs_us = np.arange(20) * DAY_US // 4 + at(0) // DAY_US * DAY_US + DAY_US
    for k, epoch_us in enumerate(epochs_us.tolist()):
        made = Checkpoint(first + k, epoch_us, FITS, b"state %d" % k)
        busy.storage.results.save_outcomes(SC, LIVE, [], first + k, epoch_us, made)
    numbers = [one.number - first for one in kept(busy) if one.content.startswith(b"state")]
    # four a day: the last of each day, and the latest four
    assert numbers == [19, 18, 17, 16, 15, 11, 7, 3]


def test_other_settings_take_no_state_of_these():
    assert fingerprint(ChainConfig(robust=RobustConfig(min_white_db=0.03))) != FITS
