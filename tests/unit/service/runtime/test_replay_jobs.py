"""Replays as jobs: the live rows bit for bit in the order of the journal, in any parts; workers are bounded."""

import os
import random
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from busy_station import BOTH, SC, at, everything, text

from db.results import jobs
from service.errors import ConflictError, InvalidInputError, NotFoundError, UnavailableError
from service.pipeline.config import ChainConfig
from service.ports.archive import LIVE
from service.records.calibration import CalibrationMethod
from service.records.catalogue import Method
from service.records.operations.work import JobState, Replay
from service.runtime.jobs import replay_run
from service.runtime.jobs.job_runner import JobInterruptedError
from service.runtime.jobs.replay_run import ReplayRun, ReplaySpan
from service.runtime.jobs.workers import WorkerConfig, Workers


def rows_of(station, version=LIVE):
    """Return the rows of both methods as text, which holds every digit."""
    return [text(station.rows(method, version)) for method in BOTH]


def test_sealed_days_replay_bit_for_bit(busy):
    archive, live = busy.storage.archive, rows_of(busy)
    by_epoch = rows_of(busy, busy.replay(1, 300, order="epoch"))
    entries = repr(archive.journal(SC, 0, 100_000))
    sealed = sum(part.rows for part in archive.seal(SC, 1 << 60, 1 << 60))
    assert sealed == sum(source.rows for source in archive.sources(SC)) > 150
    assert repr(archive.journal(SC, 0, 100_000)) == entries
    assert rows_of(busy) == rows_of(busy, busy.replay(1, 300)) == live
    assert rows_of(busy, busy.replay(1, 300, order="epoch")) == by_epoch


def test_a_replay_does_not_disturb_the_live_version_or_another_replay(busy):
    before, head = rows_of(busy), busy.storage.archive.head(SC)
    first = busy.replay(1, 100)
    kept = rows_of(busy, first)
    second = busy.replay(1, 100, order="epoch")
    assert first != second
    assert rows_of(busy) == before
    assert rows_of(busy, first) == kept
    assert busy.storage.archive.head(SC) == head


def test_in_order_of_epoch_late_rows_take_their_place(ground):
    with ground.supervised() as supervisor:
        ground.append([minute for minute in range(1, 61) if minute not in (20, 33)])
        ground.settle(supervisor)
        ground.append([20, 33])
        ground.settle(supervisor)
    assert sum("late" in row.inhibitions for row in ground.rows()) == 2
    ordered = ground.rows(ground.replay(1, 61, order="epoch"))
    assert [row.epoch_us for row in ordered] == [ground.at(minute) for minute in range(1, 61)]
    assert not any("late" in row.inhibitions for row in ordered)
    changed = [a.epoch_us for a, b in zip(ordered, ground.rows(), strict=True) if a.attitude_deg != b.attitude_deg]
    # the mean reaches fifteen minutes back; NaN differs from itself in the rows that settle
    settled = {ground.at(minute) for minute in range(20, 48)}
    assert settled <= set(changed) <= settled | {ground.at(minute) for minute in range(1, 9)}


def test_many_rows_are_stored_in_pieces(busy, monkeypatch):
    monkeypatch.setattr("service.runtime.jobs.replay_run._OUTCOMES_AT_ONCE", 7)
    monkeypatch.setattr("service.runtime.jobs.replay_run._ENTRIES_AT_ONCE", 16)
    assert rows_of(busy, busy.replay(1, 300)) == rows_of(busy)


def start(ground, **changes):
    wanted = Replay(0, ground.at(1), ground.at(9), None, None, 0, "journal", "", 0)
    return ground.replayer.start(ground.id, replace(wanted, **changes))


def test_what_cannot_be_replayed_is_refused_in_words(new_ground):
    ground = new_ground()
    with pytest.raises(ConflictError, match="was never aligned") as caught:
        start(ground)
    assert caught.value.code == "replay.not_aligned"
    ground.align()
    with pytest.raises(InvalidInputError, match="start must lie before stop"):
        start(ground, stop_us=ground.at(1))
    draft = ground.storage.results.add_calibration(
        ground.id, replace(ground.payload.request, method=CalibrationMethod.GEOMETRY), 1, 1, 0, "engineer"
    )
    with pytest.raises(ConflictError, match="has no result"):
        start(ground, calibration_id=draft.id)


def test_a_span_before_every_alignment_starts_with_the_first(ground):
    with ground.supervised() as supervisor:
        ground.append(range(1, 21))
        ground.settle(supervisor)
    early = start(ground, start_us=ground.at(-2000))[0]
    assert early.alignment_id == 1


def test_a_replay_that_is_deleted_while_it_runs_ends_and_says_so(busy, monkeypatch):
    results, calls = busy.storage.results, []
    save = results.save_outcomes

    def deleting(spacecraft_id, version, *others):
        calls.append(version)
        if len(calls) == 3:
            results.delete_replay(spacecraft_id, version)
        return save(spacecraft_id, version, *others)

    monkeypatch.setattr(results, "save_outcomes", deleting)
    monkeypatch.setattr("service.runtime.jobs.replay_run._OUTCOMES_AT_ONCE", 7)
    replay, job = start(busy, stop_us=at(300))
    assert busy.finish(job.id) is JobState.FAILED
    assert "was deleted" in results.job(job.id).error
    busy.jobs.stop()
    assert "was deleted while it was computed" in results.job(job.id).error
    assert sum(results.drop_replays(SC, None)) > 0
    with pytest.raises(NotFoundError):
        rows_of(busy, replay.version)


WANTED = Replay(0, at(1), at(300), None, None, 0, "journal", "", 0)
JOURNAL = pytest.param({}, id="as it was")
FROM_THE_MIDDLE = pytest.param({"method": Method.ROBUST, "start_us": at(60), "stop_us": at(120)}, id="of the middle")
CALIBRATED = pytest.param({"calibration_id": 1}, id="another calibration")
INDIVISIBLE = [
    pytest.param({"order": "epoch"}, id="in order of epoch"),
    pytest.param({"alignment_id": 1}, id="another alignment"),
]


@pytest.fixture
def station(archive_of_states, new_station, monkeypatch):
    monkeypatch.setattr(replay_run, "_OUTCOMES_AT_ONCE", 7)
    return new_station(archive_of_states)


def run_of(station, monkeypatch, **changes):
    """Return the run of a replay that is stored and that nothing runs yet."""
    with monkeypatch.context() as patch:
        patch.setattr(station.jobs, "run", lambda *_: None)
        version = station.replayer.start(SC, replace(WANTED, **changes))[0].version
    return version, lambda: ReplayRun(station.storage, ChainConfig(), SC, version)


def in_one_go(station, monkeypatch, **changes):
    version, run = run_of(station, monkeypatch, **changes)
    run().run(lambda _: None)
    return version


def apart(station, monkeypatch, spans_of, seed, **changes):
    """Compute the spans in any order, some of them twice, and return version and spans."""
    version, run = run_of(station, monkeypatch, **changes)
    spans, rng = spans_of(run()), random.Random(seed)
    former = {}
    for span in rng.sample(spans, len(spans)) + rng.sample(spans, len(spans) // 2):
        former[span] = run().run_span(span)
    for span in spans:
        station.storage.results.save_outcomes(SC, version, former[span], 0, None)
    return version, spans


def known_spans(run):
    return run.spans(5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("changes", [JOURNAL, FROM_THE_MIDDLE, CALIBRATED])
def test_spans_in_any_order_give_the_rows_of_one_run(station, monkeypatch, changes, seed):
    whole = in_one_go(station, monkeypatch, **changes)
    version, spans = apart(station, monkeypatch, known_spans, seed, **changes)
    assert everything(station, version) == everything(station, whole)
    assert everything(station, whole)[0] > 20
    assert len(spans) >= (2 if "calibration_id" in changes else 5)
    assert spans[0].after is None
    assert [span.after for span in spans[1:]] == [span.until for span in spans[:-1]]


@pytest.mark.slow
@pytest.mark.parametrize("changes", [JOURNAL, CALIBRATED])
def test_cuts_anywhere_in_the_journal_give_the_rows_of_one_run(station, monkeypatch, changes):
    whole = in_one_go(station, monkeypatch, **changes)
    for seed in range(3):
        rng = random.Random(seed)

        def cut_anywhere(run, rng=rng):
            (first, *_), last = run._beginnings(run._last_number()), run._last_number()
            cuts = sorted(rng.sample(range(first + 1, last), 4))
            return [ReplaySpan(*ends) for ends in zip([None, *cuts], [*cuts, last], strict=True)]

        print(f"seed {seed}")
        version, _ = apart(station, monkeypatch, cut_anywhere, seed, **changes)
        assert everything(station, version) == everything(station, whole)


@pytest.mark.slow
def test_states_that_went_meanwhile_are_made_up_for(station, monkeypatch):
    whole = in_one_go(station, monkeypatch)
    version, run = run_of(station, monkeypatch)
    spans = run().spans(5)
    table = jobs.checkpoint_table
    station.storage._database.write(lambda connection: connection.execute(table.delete()))
    for span in spans:
        station.storage.results.save_outcomes(SC, version, run().run_span(span), 0, None)
    assert everything(station, version) == everything(station, whole)


@pytest.mark.slow
def test_spans_are_no_shorter_than_asked_for(station, monkeypatch):
    _, run = run_of(station, monkeypatch)
    for least in (1, 10, 40, 100_000):
        spans = run().spans(least)
        # the first begins at the alignment
        assert all(span.until - span.after >= least for span in spans[1:])
    assert len(spans) == 1


@pytest.mark.slow
@pytest.mark.parametrize("changes", INDIVISIBLE)
def test_what_cannot_be_divided_is_one_span(station, monkeypatch, changes):
    whole = in_one_go(station, monkeypatch, **changes)
    version, spans = apart(station, monkeypatch, known_spans, 1, **changes)
    assert len(spans) == 1
    assert everything(station, version) == everything(station, whole)


@pytest.mark.slow
def test_a_span_without_rows_is_one_of_a_replay_of_nothing(station, monkeypatch):
    version, run = run_of(station, monkeypatch, start_us=at(200_000), stop_us=at(300_000))
    assert [run().run_span(span) for span in run().spans(1)] == [[]] * len(run().spans(1))
    assert everything(station, version)[:2] == (0, 0)


@pytest.fixture
def make_workers():
    """Give a maker of worker processes; they end with the test."""
    made = []

    def make(**bounds):
        made.append(Workers(WorkerConfig(**bounds)))
        return made[-1]

    yield make
    for workers in made:
        workers.stop()


def await_end(process_id):
    """Wait until a process has ended; one that is not yet collected counts as ended."""
    deadline, stat = time.monotonic() + 60, Path(f"/proc/{process_id}/stat")
    # it may end between the opening of the file and its reading
    with suppress(FileNotFoundError, ProcessLookupError):
        while stat.read_text().rpartition(")")[2].split()[0] != "Z":
            assert time.monotonic() < deadline, "the process lives"
            time.sleep(0.01)


@pytest.mark.timeout(300)
def test_work_is_done_in_another_process_that_yields_to_the_service(make_workers):
    workers = make_workers(processes=1)
    assert workers.run(pow, 2, 10) == 1024
    assert workers.run(os.getpid) == workers.run(os.getpid) != os.getpid()
    assert workers.run(os.nice, 0) > os.nice(0)


@pytest.mark.timeout(300)
def test_what_the_work_raises_reaches_the_caller_and_the_process_stays(make_workers):
    workers = make_workers(processes=1)
    process_id = workers.run(os.getpid)
    with pytest.raises(ValueError, match="invalid literal"):
        workers.run(int, "x")
    with pytest.raises(ConflictError) as caught:
        workers.run(raise_conflict)
    assert (caught.value.code, caught.value.detail) == ("thing.busy", "wait")
    assert workers.run(os.getpid) == process_id


def raise_conflict():
    """Raise an error of the service in the worker."""
    raise ConflictError("thing.busy", "wait")


@pytest.mark.timeout(300)
def test_work_beyond_its_time_is_ended_with_its_process_and_harms_no_other(make_workers):
    workers = make_workers(processes=2, job_timeout_s=1.0)
    process_id = workers.run(os.getpid)
    began = time.monotonic()
    with pytest.raises(InvalidInputError, match=r"analysis\.too_long: it was ended after 1 s"):
        workers.run(time.sleep, 10_000)
    # what comes next does not notice
    assert workers.run(pow, 2, 4) == 16
    assert time.monotonic() - began < 200
    await_end(process_id)


@pytest.mark.timeout(300)
def test_a_process_that_died_at_rest_is_replaced_unseen(make_workers):
    workers = make_workers(processes=1)
    first = workers.run(os.getpid)
    os.kill(first, signal.SIGKILL)
    await_end(first)
    # the pool may learn of the death only with the next work; then this work tells it, and the one after that runs
    try:
        second = workers.run(os.getpid)
    except UnavailableError:
        second = workers.run(os.getpid)
    assert second != first


@pytest.mark.timeout(300)
def test_a_process_that_dies_at_work_says_so(make_workers):
    workers = make_workers(processes=1)
    with pytest.raises(UnavailableError, match=r"analysis\.ended: its worker process ended unexpectedly"):
        workers.run(os._exit, 1)
    assert workers.run(pow, 2, 5) == 32


@pytest.mark.timeout(300)
def test_a_stop_ends_what_is_computed_and_what_waits(make_workers, tmp_path):
    workers = make_workers(processes=1)
    process_id = workers.run(os.getpid)
    with ThreadPoolExecutor(2) as callers:
        both = [callers.submit(workers.run, never_end, tmp_path / "begun") for _ in range(2)]
        await_prepared(tmp_path / "begun")
        workers.stop()
        for each in both:
            with pytest.raises(UnavailableError, match="the service is stopping"):
                each.result()
    await_end(process_id)
    with pytest.raises(UnavailableError, match="the service is stopping"):
        workers.run(pow, 2, 2)


@pytest.mark.timeout(300)
@pytest.mark.parametrize("bound", [{"processes": 0}, {"max_calibrations": 0}, {"job_timeout_s": 0.0}])
def test_bounds_that_let_nothing_through_are_refused(bound):
    with pytest.raises(ValueError, match="at least one process"):
        WorkerConfig(**bound)


def end_at_first(folder, times):
    """Die a number of times, then leave a mark."""
    died = len(list(folder.iterdir()))
    (folder / str(died)).touch()
    if died < times:
        os.kill(os.getpid(), signal.SIGKILL)


def leave_process_id(path):
    """Write the number of this process."""
    path.write_text(str(os.getpid()))


def never_end(path):
    """Leave the number of this process, then work for hours."""
    leave_process_id(path)
    time.sleep(10_000)


def await_prepared(path):
    """Return the number of the prepared process."""
    deadline = time.monotonic() + 60
    while not (path.exists() and path.read_text()):
        assert time.monotonic() < deadline, "no process was prepared"
        time.sleep(0.01)
    return int(path.read_text())


@pytest.mark.timeout(300)
def test_a_prepared_process_takes_the_first_work_and_ends_with_the_workers(make_workers, tmp_path):
    workers = make_workers(processes=1)
    workers.prepare(0.0, partial(leave_process_id, tmp_path / "id"))
    process_id = await_prepared(tmp_path / "id")
    workers.prepare(0.0, partial(os._exit, 1))
    assert workers.run(os.getpid) == process_id
    workers.stop()
    await_end(process_id)


@pytest.mark.timeout(300)
def test_work_goes_on_in_another_process_when_the_prepared_one_was_killed(make_workers, tmp_path):
    workers = make_workers(processes=1)
    workers.prepare(0.0, partial(leave_process_id, tmp_path / "id"))
    process_id = await_prepared(tmp_path / "id")
    os.kill(process_id, signal.SIGKILL)
    await_end(process_id)
    workers.complete(leave_process_id, tmp_path / "second")
    assert int((tmp_path / "second").read_text()) != process_id


@pytest.mark.timeout(300)
def test_a_stop_before_its_time_leaves_no_process_prepared(make_workers, tmp_path):
    workers = make_workers(processes=1)
    workers.prepare(0.2, partial(leave_process_id, tmp_path / "id"))
    workers.stop()
    workers.prepare(0.0, partial(leave_process_id, tmp_path / "id"))
    time.sleep(1.0)
    assert not (tmp_path / "id").exists()


@pytest.mark.timeout(300)
def test_work_that_goes_on_where_it_was_gets_another_process_when_its_own_dies(make_workers, tmp_path):
    workers = make_workers(processes=1)
    workers.complete(end_at_first, tmp_path, 2)
    assert len(list(tmp_path.iterdir())) == 3
    with pytest.raises(UnavailableError, match="ended unexpectedly"):
        workers.complete(end_at_first, tmp_path, 99)


@pytest.mark.timeout(300)
def test_a_stop_interrupts_work_that_goes_on_later(make_workers, tmp_path):
    workers = make_workers(processes=1)
    with ThreadPoolExecutor(1) as threads:
        waiting = threads.submit(workers.complete, mark_and_sleep, tmp_path)
        while not list(tmp_path.iterdir()):
            time.sleep(0.01)
        workers.stop()
        with pytest.raises(JobInterruptedError):
            waiting.result(timeout=60)


def mark_and_sleep(folder):
    """Leave a mark and sleep for longer than any test."""
    (folder / "mark").touch()
    time.sleep(600)
