"""A replay whose spans are computed apart, in any order and again, is the replay that was computed in one go."""

import random
from dataclasses import replace

import pytest
from busy_station import SC, at, everything

from db.results import checkpoints
from service.pipeline.config import ChainConfig
from service.records.catalogue import Method
from service.records.operations.job import Replay
from service.runtime.jobs import replay_run
from service.runtime.jobs.replay_run import ReplayRun, ReplaySpan

#: replays of a busy morning, cut in many ways
pytestmark = pytest.mark.slow

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


def test_states_that_went_meanwhile_are_made_up_for(station, monkeypatch):
    whole = in_one_go(station, monkeypatch)
    version, run = run_of(station, monkeypatch)
    spans = run().spans(5)
    table = checkpoints.checkpoint_table
    station.storage._database.write(lambda connection: connection.execute(table.delete()))
    for span in spans:
        station.storage.results.save_outcomes(SC, version, run().run_span(span), 0, None)
    assert everything(station, version) == everything(station, whole)


def test_spans_are_no_shorter_than_asked_for(station, monkeypatch):
    _, run = run_of(station, monkeypatch)
    for least in (1, 10, 40, 100_000):
        spans = run().spans(least)
        # the first begins at the alignment
        assert all(span.until - span.after >= least for span in spans[1:])
    assert len(spans) == 1


@pytest.mark.parametrize("changes", INDIVISIBLE)
def test_what_cannot_be_divided_is_one_span(station, monkeypatch, changes):
    whole = in_one_go(station, monkeypatch, **changes)
    version, spans = apart(station, monkeypatch, known_spans, 1, **changes)
    assert len(spans) == 1
    assert everything(station, version) == everything(station, whole)


def test_a_span_without_rows_is_one_of_a_replay_of_nothing(station, monkeypatch):
    version, run = run_of(station, monkeypatch, start_us=at(200_000), stop_us=at(300_000))
    assert [run().run_span(span) for span in run().spans(1)] == [[]] * len(run().spans(1))
    assert everything(station, version)[:2] == (0, 0)
