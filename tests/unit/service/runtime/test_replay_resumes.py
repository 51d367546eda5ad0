"""A replay whose process is killed goes on from its last checkpoint and gives the rows of one that was not."""

import os
import random
import signal
from dataclasses import replace
from functools import partial

import pytest
from busy_station import BOTH, SC, at, everything
from storage_parts import with_part

from db.storage import SqlStorage
from service.pipeline.checkpoints import fingerprint, pack_state
from service.pipeline.config import ChainConfig
from service.records.catalogue import Method
from service.records.operations.work import JobState, Replay
from service.runtime.jobs import replay as replay_run
from service.runtime.jobs.job_runner import JobPieces, JobRunner, JobWorker
from service.runtime.jobs.replay import ReplayRun, replay_work
from service.runtime.live.journal_consumer import state_of

#: replays of a busy morning, again and again
pytestmark = pytest.mark.slow

WANTED = Replay(0, at(1), at(300), None, None, 0, "journal", "", 0)


class KilledError(BaseException):
    """The process ends here."""


@pytest.fixture(autouse=True)
def _often(monkeypatch):
    """Checkpoints at every piece, which holds the rows of one block and no more."""
    monkeypatch.setattr(replay_run, "_CHECKPOINT_S", 0.0)
    monkeypatch.setattr(replay_run, "BLOCK_ROWS", 5)
    monkeypatch.setattr(replay_run, "_OUTCOMES_AT_ONCE", 7)


def stored(station, **changes):
    """Store a replay that nothing runs yet, and return its version."""
    return station.replayer.start(SC, replace(WANTED, **changes))[0].version


def run(station, version, kill_after=None):
    """Run a replay, killed right before a piece is stored; return how many were."""
    save, saves = station.storage.results.save_outcomes, []

    def save_outcomes(*arguments):
        if len(saves) == kill_after:
            raise KilledError
        saves.append(arguments)
        return save(*arguments)

    storage = with_part(station.storage, "results", save_outcomes=save_outcomes)
    try:
        for _ in ReplayRun(storage, ChainConfig(), SC, version).pieces():
            pass
    except KilledError:
        assert kill_after is not None
    return len(saves)


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({}, id="in the order of the journal"),
        pytest.param({"order": "epoch", "alignment_id": 1}, id="in order of epoch"),
        pytest.param({"calibration_id": 1, "alignment_id": 1, "commands": False}, id="another calibration"),
        pytest.param({"method": Method.PAPER, "start_us": at(40)}, id="one method from the middle"),
    ],
)
def test_a_run_that_is_killed_again_and_again_gives_the_same_rows(busy, monkeypatch, changes):
    whole, broken = (stored(busy, **changes) for _ in range(2))
    pieces = run(busy, whole)
    kills = [max(1, pieces // 4), 1, max(1, pieces // 3)]
    saves = sum(run(busy, broken, kill) for kill in kills) + run(busy, broken)
    assert everything(busy, broken) == everything(busy, whole)
    assert everything(busy, whole)[0] > 50
    # nothing but the piece in hand is computed twice
    assert saves <= pieces + 2 * len(kills)


@pytest.mark.parametrize("damage", ["cut off", "bit flipped", "of another layout"])
def test_a_checkpoint_that_does_not_fit_makes_the_run_begin_again(busy, monkeypatch, damage):
    whole, broken = (stored(busy) for _ in range(2))
    run(busy, whole)
    run(busy, broken, 5)
    results = busy.storage.results
    kept = results.replay_checkpoint(SC, broken, fingerprint(ChainConfig()))
    content = bytearray(kept.content)
    content[len(content) // 2] ^= 1
    made = {
        "cut off": replace(kept, content=kept.content[:1000]),
        "bit flipped": replace(kept, content=bytes(content)),
        "of another layout": replace(kept, fingerprint="other"),
    }[damage]
    results.save_outcomes(SC, broken, [], 0, None, made)
    run(busy, broken)
    assert everything(busy, broken) == everything(busy, whole)


def test_damaged_bytes_of_a_checkpoint_are_never_more_than_a_warning(busy, monkeypatch):
    broken = stored(busy)
    run(busy, broken, 5)
    kept = busy.storage.results.replay_checkpoint(SC, broken, fingerprint(ChainConfig()))
    seed = 7
    print("seed", seed)
    dice, unread, whole = random.Random(seed), 0, pack_state(state_of(SC, kept))
    for _ in range(300):
        content = bytearray(kept.content)
        content[dice.randrange(len(content))] ^= 1 << dice.randrange(8)
        state = state_of(
            SC, replace(kept, content=bytes(content[: dice.choice([len(content), dice.randrange(len(content))])]))
        )
        unread += state is None
        # a bit of a date in the file's directory changes nothing
        assert state is None or pack_state(state) == whole
    assert unread > 250


def test_rows_that_came_after_the_start_are_not_read_after_a_kill_either(busy, monkeypatch):
    broken = stored(busy)
    run(busy, broken, 3)
    busy.send([299.0])
    run(busy, broken)
    assert max(row.epoch_us for row in busy.rows(Method.ROBUST, broken)) < at(299)


def works_in_process(url):
    """Return storage and works of a worker process."""
    storage = SqlStorage(url)
    return storage, {"replay": partial(replay_work, storage, ChainConfig())}


def test_a_worker_process_that_is_killed_is_replaced_and_goes_on(busy, wait):
    whole, broken = (stored(busy) for _ in range(2))
    run(busy, whole)
    busy.storage.results.end_job(busy.storage.results.replay(SC, whole).replay.job_id)
    results, job_id = busy.storage.results, busy.storage.results.replay(SC, broken).replay.job_id
    worker = JobWorker(partial(works_in_process, busy.url))
    jobs = JobRunner(busy.storage, busy.clock, worker.advance)
    jobs.start()
    try:
        wait(lambda: results.replay(SC, broken).attitude_rows > 0)
        os.kill(worker._process_id, signal.SIGKILL)
        wait(lambda: results.job(job_id).state is JobState.DONE)
    finally:
        worker.stop()
        jobs.stop()
    assert everything(busy, broken) == everything(busy, whole)


def test_the_next_service_goes_on_with_what_is_unfinished_once(busy):
    waiting, done = stored(busy), stored(busy, stop_us=at(20))
    gone = stored(busy)
    results = busy.storage.results
    results.end_job(results.replay(SC, done).replay.job_id)
    job_of_gone = results.replay(SC, gone).replay.job_id
    results.delete_replay(SC, gone)
    assert results.job(job_of_gone).state is JobState.FAILED
    begun = results.replay(SC, waiting).replay.job_id
    assert results.hold_job(begun, "the one before")
    advanced = []

    def runner():
        pieces = JobPieces({"replay": partial(replay_work, busy.storage, ChainConfig())})

        def advance(job, open_ids):
            advanced.append(job.id)
            return pieces.advance(job, open_ids)

        return JobRunner(busy.storage, busy.clock, advance)

    first, second = runner(), runner()
    assert not first.poll_once(), "another process may run it"
    first.take_over()
    assert first.poll_once()
    assert not second.poll_once()
    while first.poll_once():
        pass
    assert set(advanced) == {begun}
    assert len(busy.rows(Method.ROBUST, waiting)) > 50


def test_months_without_rows_and_changes_of_the_plan_within_a_span(busy):
    with busy.supervised() as settle:
        busy.send(range(200_000, 200_020), source="sa-2")
        settle()
    span = {"start": 70, "stop": 300_000}
    live = [busy.rows(method, **span) for method in BOTH]
    assert len(live[0]) > 80
    version = busy.replay(**span)
    assert repr([busy.rows(method, version, **span) for method in BOTH]) == repr(live)
    assert repr(busy.commands(version, **span)) == repr(busy.commands(**span))
    by_epoch = busy.replay(**span, order="epoch")
    for method, rows in zip(BOTH, live, strict=True):
        epochs_us = [row.epoch_us for row in busy.rows(method, by_epoch, **span)]
        assert epochs_us == [row.epoch_us for row in rows]


def test_a_span_without_rows_gives_a_version_without_rows(busy, monkeypatch):
    version = stored(busy, start_us=at(200_000), stop_us=at(300_000), order="epoch")
    run(busy, version)
    assert everything(busy, version) == (0, 0, [[], []], [], [{}, {}])
