"""Replays: in the order of the journal the live rows bit for bit, else what would have been."""

from dataclasses import replace

import numpy as np
import pytest

from service.errors import ConflictError, InvalidInputError, NotFoundError
from service.records.calibration import CalibrationMethod
from service.records.catalogue import Method
from service.records.operations.job import JobState, Replay


@pytest.mark.parametrize(
    ("start", "stop"),
    [
        pytest.param(1, 300, id="the whole day"),
        pytest.param(25, 90, id="from the middle"),
        pytest.param(140, 200, id="rows that a later alignment caught up with first"),
        pytest.param(170, 210, id="rows of the second alignment only"),
    ],
)
def test_a_replay_in_the_order_of_the_journal_is_the_live_run_bit_for_bit(lived, start, stop):
    version = lived.replay(start, stop)
    live, again = lived.rows(start=start, stop=stop), lived.rows(version, start, stop)
    assert len(live) > 10
    # the text of a record holds every digit of every float, and tells NaN and -0.0
    assert [repr(row) for row in again] == [repr(row) for row in live]
    commands = lived.commands(version, start, stop)
    assert [repr(item) for item in commands] == [repr(item) for item in lived.commands(start=start, stop=stop)]


def test_sealed_days_replay_bit_for_bit(lived):
    live = [repr(row) for row in lived.rows()]
    before = [repr(row) for row in lived.rows(lived.replay(1, 300))]
    by_epoch = [repr(row) for row in lived.rows(lived.replay(1, 300, order="epoch"))]
    entries = repr(lived.storage.archive.journal(lived.id, 0, 100_000))
    sealed = sum(part.rows for part in lived.storage.archive.seal(lived.id, 1 << 60, 1 << 60))
    assert sealed == sum(source.rows for source in lived.storage.archive.sources(lived.id)) > 1000
    assert repr(lived.storage.archive.journal(lived.id, 0, 100_000)) == entries
    assert [repr(row) for row in lived.rows()] == live
    assert [repr(row) for row in lived.rows(lived.replay(1, 300))] == before == live
    assert [repr(row) for row in lived.rows(lived.replay(1, 300, order="epoch"))] == by_epoch


def test_the_day_holds_what_its_name_promises(lived):
    rows = lived.rows()
    reasons = {reason for row in rows for reason in row.inhibitions}
    assert {"late", "settling", "no_fix", "operation"} <= reasons
    assert {row.calibration_id for row in rows} == {1, 2}
    assert {row.alignment_id for row in rows} == {1, 2}
    assert any(item.reason == "uplink_fade" for row in rows for item in row.excluded)
    assert any(np.isnan(row.attitude_deg.roll) for row in rows)


def test_a_replay_does_not_disturb_the_live_version_or_another_replay(lived):
    before, head = repr(lived.rows()), lived.storage.archive.head(lived.id)
    first = lived.replay(1, 100)
    kept = repr(lived.rows(first))
    second = lived.replay(1, 100, order="epoch")
    assert first != second
    assert repr(lived.rows()) == before
    assert repr(lived.rows(first)) == kept
    assert lived.storage.archive.head(lived.id) == head


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


def test_with_another_calibration_its_figures_are_used_throughout(lived):
    rows = lived.rows(lived.replay(1, 220, calibration_id=1))
    assert {row.calibration_id for row in rows} == {1}
    assert {row.calibration_id for row in lived.rows()} == {1, 2}


def test_with_an_alignment_named_no_later_one_replaces_it(lived):
    rows = lived.rows(lived.replay(1, 220, alignment_id=1))
    assert {row.alignment_id for row in rows} == {1}


def test_one_method_alone_may_be_replayed(ground):
    ground.append(range(1, 11))
    assert len(ground.rows(ground.replay(1, 11, method=Method.PAPER))) == 10
    assert ground.rows(ground.replay(1, 11, method=Method.ROBUST)) == []


def test_many_rows_are_stored_in_pieces(lived, monkeypatch):
    monkeypatch.setattr("service.runtime.jobs.replay_run._OUTCOMES_AT_ONCE", 7)
    monkeypatch.setattr("service.runtime.jobs.replay_run._ENTRIES_AT_ONCE", 16)
    assert repr(lived.rows(lived.replay(1, 300))) == repr(lived.rows())


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


def test_a_replay_that_is_deleted_while_it_runs_ends_and_says_so(lived, monkeypatch):
    results, calls = lived.storage.results, []
    save = results.save_outcomes

    def deleting(spacecraft_id, version, *others):
        calls.append(version)
        if len(calls) == 3:
            results.delete_replay(spacecraft_id, version)
        return save(spacecraft_id, version, *others)

    monkeypatch.setattr(results, "save_outcomes", deleting)
    monkeypatch.setattr("service.runtime.jobs.replay_run._OUTCOMES_AT_ONCE", 7)
    replay, job = start(lived, stop_us=lived.at(300))
    assert lived.finish(job.id) is JobState.FAILED
    assert "was deleted" in results.job(job.id).error
    lived.jobs.stop()
    assert "was deleted while it was computed" in results.job(job.id).error
    assert sum(results.drop_replays(lived.id, None)) > 0
    with pytest.raises(NotFoundError):
        lived.rows(replay.version)
