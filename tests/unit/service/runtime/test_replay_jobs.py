"""Replays as jobs: the live rows bit for bit in the order of the journal, in any parts; workers are bounded."""

import random
from dataclasses import replace

import pytest
from busy_station import BOTH, SC, at, everything, text

from db.results import jobs
from service.errors import ConflictError, InvalidInputError, NotFoundError
from service.pipeline.config import ChainConfig
from service.ports.archive import LIVE
from service.records.calibration import CalibrationMethod
from service.records.catalogue import Method
from service.records.operations.work import JobState, Replay
from service.runtime.jobs import replay as replay_run
from service.runtime.jobs.replay import ReplayRun, ReplaySpan


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
    monkeypatch.setattr("service.runtime.jobs.replay._OUTCOMES_AT_ONCE", 7)
    monkeypatch.setattr("service.runtime.jobs.replay._ENTRIES_AT_ONCE", 16)
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
    monkeypatch.setattr("service.runtime.jobs.replay._OUTCOMES_AT_ONCE", 7)
    replay, job = start(busy, stop_us=at(300))
    assert busy.finish(job.id) is JobState.FAILED
    busy.jobs.poll_once()
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


def run_of(station, **changes):
    """Return the run of a replay that is stored and that nothing runs yet."""
    version = station.replayer.start(SC, replace(WANTED, **changes))[0].version
    return version, lambda: ReplayRun(station.storage, ChainConfig(), SC, version)


def in_one_go(station, **changes):
    version, run = run_of(station, **changes)
    for _ in run().pieces():
        pass
    return version


def apart(station, spans_of, seed, **changes):
    """Compute the spans in any order, some of them twice, and return version and spans."""
    version, run = run_of(station, **changes)
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
    whole = in_one_go(station, **changes)
    version, spans = apart(station, known_spans, seed, **changes)
    assert everything(station, version) == everything(station, whole)
    assert everything(station, whole)[0] > 20
    assert len(spans) >= (2 if "calibration_id" in changes else 5)
    assert spans[0].after is None
    assert [span.after for span in spans[1:]] == [span.until for span in spans[:-1]]


@pytest.mark.slow
@pytest.mark.parametrize("changes", [JOURNAL, CALIBRATED])
def test_cuts_anywhere_in_the_journal_give_the_rows_of_one_run(station, monkeypatch, changes):
    whole = in_one_go(station, **changes)
    for seed in range(3):
        rng = random.Random(seed)

        def cut_anywhere(run, rng=rng):
            (first, *_), last = run._beginnings(run._last_number()), run._last_number()
            cuts = sorted(rng.sample(range(first + 1, last), 4))
            return [ReplaySpan(*ends) for ends in zip([None, *cuts], [*cuts, last], strict=True)]

        print(f"seed {seed}")
        version, _ = apart(station, cut_anywhere, seed, **changes)
        assert everything(station, version) == everything(station, whole)


@pytest.mark.slow
def test_states_that_went_meanwhile_are_made_up_for(station, monkeypatch):
    whole = in_one_go(station)
    version, run = run_of(station)
    spans = run().spans(5)
    table = jobs.checkpoint_table
    station.storage._database.write(lambda connection: connection.execute(table.delete()))
    for span in spans:
        station.storage.results.save_outcomes(SC, version, run().run_span(span), 0, None)
    assert everything(station, version) == everything(station, whole)


@pytest.mark.slow
def test_spans_are_no_shorter_than_asked_for(station, monkeypatch):
    _, run = run_of(station)
    for least in (1, 10, 40, 100_000):
        spans = run().spans(least)
        # the first begins at the alignment
        assert all(span.until - span.after >= least for span in spans[1:])
    assert len(spans) == 1


@pytest.mark.slow
@pytest.mark.parametrize("changes", INDIVISIBLE)
def test_what_cannot_be_divided_is_one_span(station, monkeypatch, changes):
    whole = in_one_go(station, **changes)
    version, spans = apart(station, known_spans, 1, **changes)
    assert len(spans) == 1
    assert everything(station, version) == everything(station, whole)


@pytest.mark.slow
def test_a_span_without_rows_is_one_of_a_replay_of_nothing(station, monkeypatch):
    version, run = run_of(station, start_us=at(200_000), stop_us=at(300_000))
    assert [run().run_span(span) for span in run().spans(1)] == [[]] * len(run().spans(1))
    assert everything(station, version)[:2] == (0, 0)
