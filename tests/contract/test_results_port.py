"""Every storage keeps calibrations, alignments, jobs and replays with their states and ids."""

from dataclasses import replace
from uuid import uuid4

import numpy as np
import pytest

from service.core.rows.sample_bins import SampleBins
from service.errors import ConflictError, NotFoundError
from service.ports import LIVE, Outcome
from service.records.calibration import (
    Alignment,
    CalibrationMethod,
    CalibrationRequest,
    CalibrationResult,
    CalibrationState,
    CarrierCalibration,
    CarrierReference,
    Harmonic,
    NoiseComponent,
    Observability,
    Window,
)
from service.records.catalogue import Method
from service.records.inputs import AlignmentSet, CalibrationActivation
from service.records.levels.attitude import NO_ANGLES, Axes
from service.records.levels.carrier_results import CarrierResults
from service.records.operations.job import Job, JobState, Replay
from service.records.storage.checkpoint import Checkpoint

HOURS = SampleBins(0, 86_400_000_000, 24, 1)
CARRIERS = CarrierResults(1, *np.ones((2, 3)), *np.zeros((2, 3), dtype=np.int64))
AXES = Axes(0.1, -0.2, 0.3)
REQUEST = CalibrationRequest(Window(0, 10), Window(10, 20), CalibrationMethod.GEOMETRY, source_yaw="radio_beacon")
CARRIER = CarrierCalibration(
    id="c00",
    level_dbm=-50.123456789,
    sigma_white_db=0.05,
    noise=(NoiseComponent(60.0, 0.02), NoiseComponent(3600.0, 0.1)),
    harmonic=Harmonic(0.3, 1.0, -50.0, 86_164.1, 5, 0.04, 8640, 12),
    sensitivity_db_per_deg=AXES,
    sensitivity_plus_db_per_deg=AXES,
    sensitivity_minus_db_per_deg=AXES,
    residual_db=0.01,
    stability_residual_rms_db=0.02,
    drift_db_per_day=1e-17,
    deviation_at_0p5_deg_db=0.03,
    nonlinearity_deg=0.004,
    linear_range_deg=0.5,
    axis="roll",
    axis_ratio=4.5,
    criteria_met=("stable", "linear"),
    rejected_because=("mixed",),
    selected=True,
)
RESULT = CalibrationResult((CARRIER,), Observability(4.0, AXES, AXES), {"chi_square": float("inf")}, ("few rows",))


def states(setting):
    return {found.id: found.state.value for found in setting.storage.results.calibrations(setting.id)}


def test_a_calibration_lives_from_draft_to_superseded(setting):
    results = setting.storage.results
    draft = results.add_calibration(setting.id, REQUEST, 1, 1, 55, "engineer")
    assert (draft.id, draft.state, draft.result) == (1, CalibrationState.DRAFT, None)
    finished = results.finish_calibration(setting.id, 1, RESULT, None)
    assert finished == replace(draft, result=RESULT)
    assert results.calibration(setting.id, 1) == finished
    assert results.activate_calibration(setting.id, 1).state is CalibrationState.ACTIVE
    setting.calibrate(CalibrationMethod.PAPER)
    assert states(setting) == {1: "active", 2: "active"}
    setting.calibrate(CalibrationMethod.GEOMETRY)
    assert states(setting) == {1: "superseded", 2: "active", 3: "active"}
    results.activate_calibration(setting.id, 1)
    assert states(setting) == {1: "active", 2: "active", 3: "superseded"}
    journaled = [entry.content for entry in setting.storage.archive.journal(setting.id, 3, 99)]
    expected = [(1, 1), (2, 2), (3, 3), (1, 4)]
    assert journaled == [CalibrationActivation(calibration_id, count) for calibration_id, count in expected]


def test_calibrations_are_listed_newest_first_and_by_state(setting):
    setting.calibrate()
    setting.calibrate()
    setting.storage.results.add_calibration(setting.id, REQUEST, 1, 1, 55, "engineer")
    listed = setting.storage.results.calibrations
    assert [found.id for found in listed(setting.id)] == [3, 2, 1]
    assert [found.id for found in listed(setting.id, CalibrationState.SUPERSEDED)] == [1]


def test_a_failed_calibration_says_why_and_cannot_be_activated_or_finished_again(setting):
    results = setting.storage.results
    results.add_calibration(setting.id, REQUEST, 1, 1, 55, "engineer")
    failed = results.finish_calibration(setting.id, 1, None, "no turns in the window")
    assert (failed.state, failed.error) == (CalibrationState.FAILED, "no turns in the window")
    with pytest.raises(ConflictError) as caught:
        results.activate_calibration(setting.id, 1)
    assert caught.value.code == "calibration.no_result"
    with pytest.raises(ConflictError) as caught:
        results.finish_calibration(setting.id, 1, RESULT, None)
    assert caught.value.code == "calibration.finished"


def test_an_alignment_is_stored_and_journaled(setting):
    results = setting.storage.results
    calibration = setting.calibrate()
    references = (CarrierReference("c00", -50.1, 0.02, 60, float("inf")),)
    wanted = Alignment(
        0,
        15,
        AXES,
        NO_ANGLES,
        calibration.id,
        "manual",
        6,
        "approver",
        references,
        Window(1, 2),
        "rain",
        {"paper": references},
    )
    first, second = (
        results.add_alignment(setting.id, wanted),
        results.add_alignment(setting.id, replace(wanted, epoch_us=5)),
    )
    assert (first.id, second.id) == (1, 2)
    # repr, because NaN is not equal to itself
    assert repr(results.alignment(setting.id, 1)) == repr(replace(wanted, id=1))
    assert [found.id for found in results.alignments(setting.id)] == [2, 1]
    entries = setting.storage.archive.journal(setting.id, 4, 9)
    assert [entry.content for entry in entries] == [AlignmentSet(1), AlignmentSet(2)]
    assert results.alignment_number(setting.id, 2) == entries[1].number
    with pytest.raises(NotFoundError) as caught:
        results.add_alignment(setting.id, replace(wanted, calibration_id=9))
    assert caught.value.code == "calibration.unknown"


def test_jobs_are_followed_and_those_of_a_dead_process_fail(storage):
    results = storage.results
    for position, state in enumerate((JobState.QUEUED, JobState.RUNNING, JobState.DONE)):
        results.add_job(Job(f"job-{position}", "calibration", state, 0.0, 5))
    results.update_job("job-1", JobState.RUNNING, 0.1 + 0.2)
    # the progress is stored, not computed: equal without tolerance
    assert results.job("job-1") == Job("job-1", "calibration", JobState.RUNNING, 0.1 + 0.2, 5)
    results.add_job(Job("job-0a", "replay", JobState.QUEUED, 0.0, 1 << 60))
    assert [job.id for job in results.newest_jobs(2)] == ["job-0a", "job-2"]
    results.update_job("job-0a", JobState.DONE, 1.0)
    with pytest.raises(ConflictError) as caught:
        results.add_job(Job("job-1", "replay", JobState.QUEUED, 0.0, 5))
    assert caught.value.code == "job.exists"
    assert results.fail_unfinished_jobs("the service was stopped") == 2
    assert [results.job(f"job-{position}").state.value for position in range(3)] == ["failed", "failed", "done"]
    assert results.job("job-0").error == "the service was stopped"
    for call in (lambda: results.job("none"), lambda: results.update_job("none", JobState.DONE, 1.0)):
        with pytest.raises(NotFoundError) as unknown:
            call()
        assert unknown.value.code == "job.unknown"


def test_drafts_of_a_dead_process_fail_with_its_jobs_and_finished_ones_stay(setting):
    results = setting.storage.results
    for _ in range(2):
        results.add_calibration(setting.id, REQUEST, 1, 1, 55, "engineer")
    results.finish_calibration(setting.id, 1, RESULT, None)
    assert results.fail_unfinished_jobs("the service was stopped") == 0
    assert states(setting) == {1: "draft", 2: "failed"}
    assert results.calibration(setting.id, 2).error == "the service was stopped"
    assert results.calibration(setting.id, 1).result == RESULT


def test_a_replay_is_found_by_the_version_it_writes(setting):
    results = setting.storage.results
    wanted = Replay(0, 1, 2, Method.PAPER, None, 3, "journal", "job-1", 9)
    stored = results.add_replay(setting.id, wanted)
    assert stored == replace(wanted, id=1)
    assert results.replay(setting.id, "replay-1").replay == stored
    for version in ("replay-2", "replay-01", "live", "1", "replay-", "replay-99999999999999999999"):
        with pytest.raises(NotFoundError) as caught:
            results.replay(setting.id, version)
        assert caught.value.code == "replay.unknown"


@pytest.mark.parametrize(
    ("call", "code"),
    [
        (lambda results, name: results.calibration(name, 1), "calibration.unknown"),
        (lambda results, name: results.activate_calibration(name, 1), "calibration.unknown"),
        (lambda results, name: results.finish_calibration(name, 1, RESULT, None), "calibration.unknown"),
        (lambda results, name: results.alignment(name, 1), "alignment.unknown"),
        (lambda results, name: results.alignment_number(name, 1), "alignment.unknown"),
        (lambda results, name: results.pending("none", []), "spacecraft.unknown"),
    ],
)
def test_what_is_not_there_is_named(setting, call, code):
    with pytest.raises(NotFoundError) as caught:
        call(setting.storage.results, setting.id)
    assert caught.value.code == code


# ---- versions of replays -----------------------------------------------------------------------------------------

EVER = Window(0, 1 << 60)


@pytest.fixture
def add(setting):
    """Return what stores a replay with a job of a state."""

    def made(state=JobState.DONE, **changes):
        name = f"job-{uuid4()}"
        setting.storage.results.add_job(Job(name, "replay", state, 0.5, 5))
        wanted = Replay(0, 10, 20, Method.PAPER, None, 3, "journal", name, 9)
        return setting.storage.results.add_replay(setting.id, replace(wanted, **changes)).version

    return made


@pytest.fixture
def written(setting, make):
    """Outcomes of three measurements."""
    setting.append([10, 20, 30])
    return [Outcome((make.attitude_row(row),), make.torque_command(row)) for row in setting.rows()]


def code_of(call):
    with pytest.raises((NotFoundError, ConflictError)) as caught:
        call()
    return caught.value.code


def test_a_replay_counts_what_it_wrote_each_row_once(setting, add, written):
    version = add()
    setting.consume(written[:2], version)
    setting.consume(written, version)
    found = setting.storage.results.replay(setting.id, version)
    assert (found.attitude_rows, found.torque_rows, found.size_bytes) == (3, 3, 3 * (320 + 640))
    assert (found.state, found.progress, found.error) == (JobState.DONE, 0.5, None)


def test_replays_are_listed_by_span_page_by_page(setting, add):
    results = setting.storage.results
    versions = [add(start_us=10 * k, stop_us=10 * k + 10) for k in range(4)]
    listed = results.replays(setting.id, Window(10, 31), 9, 0)
    assert [each.replay.version for each in listed] == versions[1:]
    assert [each.replay.id for each in results.replays(setting.id, EVER, 2, 1)] == [2, 3]


@pytest.mark.parametrize("is_sealed", [False, True])
def test_a_deleted_version_is_nobodys_to_read_or_write_and_its_rows_go(setting, make, add, written, is_sealed):
    results = setting.storage.results
    kept, gone = add(), add()
    for version in (kept, gone):
        setting.consume(written, version)
    if is_sealed:
        assert sum(part.rows for part in results.seal(setting.id, 1 << 60)) == 12
    results.delete_replay(setting.id, gone)
    calls = (
        lambda: results.replay(setting.id, gone),
        lambda: results.delete_replay(setting.id, gone),
        lambda: results.attitude_rows(setting.id, gone, Method.ROBUST, make.ever, 9, None),
        lambda: results.commands(setting.id, gone, make.ever, 9, None),
        lambda: list(results.sampled_attitude(setting.id, gone, Method.ROBUST, make.ever, HOURS)),
        lambda: list(results.sampled_carriers(setting.id, gone, Method.ROBUST, make.ever, HOURS)),
        lambda: list(results.sampled_impulse(setting.id, gone, make.ever, HOURS)),
    )
    assert {code_of(call) for call in calls} == {"replay.unknown"}
    assert code_of(lambda: setting.consume(written, gone)) == "replay.deleted"
    assert [each.replay.version for each in results.replays(setting.id, EVER, 9, 0)] == [kept]
    assert sum(results.drop_replays(setting.id, None)) == 6
    assert list(results.drop_replays(setting.id, None)) == []
    assert len(results.attitude_rows(setting.id, kept, Method.ROBUST, make.ever, 9, None)) == 3
    assert len(results.commands(setting.id, kept, make.ever, 9, None)) == 3
    # the number is not given again
    assert add() == "replay-3"


@pytest.mark.parametrize("read", ["sampled_attitude", "sampled_carriers"])
def test_a_version_that_is_deleted_while_it_is_sampled_gives_no_part(setting, add, written, monkeypatch, read):
    monkeypatch.setattr("db.results.stored_rows._PAGE_ROWS", 1)
    results, version = setting.storage.results, add()
    setting.consume([replace(each, carriers=(CARRIERS,)) for each in written], version)
    found = getattr(results, read)(setting.id, version, Method.ROBUST, EVER, HOURS)
    next(found)
    results.delete_replay(setting.id, version)
    assert code_of(lambda: list(found)) == "replay.unknown"


def test_results_and_their_checkpoint_are_stored_together_or_not_at_all(setting, make, written, monkeypatch):
    """A kill between the two: the transaction is gone, and the next process computes the rows again."""
    results, made = setting.storage.results, Checkpoint(7, 30, "fits", b"state")

    def killed(*_):
        raise RuntimeError

    with monkeypatch.context() as patch:
        patch.setattr("db.results.outcomes.store_checkpoint", killed)
        with pytest.raises(RuntimeError):
            results.save_outcomes(setting.id, LIVE, written, 7, 30, made)
    assert setting.storage.archive.head(setting.id).consumed_number == 0
    assert results.results_after(setting.id, 0, 9) == []
    results.save_outcomes(setting.id, LIVE, written, 7, 30, made)
    assert [sequence for sequence, _ in results.results_after(setting.id, 0, 9)] == [1, 2, 3, 4, 5, 6]
    assert list(results.checkpoints(setting.id, "fits", 7)) == [made]


def test_retention_takes_finished_versions_by_their_age(setting, add, written):
    results = setting.storage.results
    old, running, new = add(created_at_us=5), add(JobState.RUNNING, created_at_us=5), add(created_at_us=50)
    for version in (old, new):
        setting.consume(written, version)
    assert sum(results.drop_replays(setting.id, 50)) == 6
    assert [each.replay.version for each in results.replays(setting.id, EVER, 9, 0)] == [running, new]
