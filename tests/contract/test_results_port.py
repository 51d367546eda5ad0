"""Every storage keeps results once, in the order they were made: rows, calibrations, alignments, jobs and replays."""

import math
from dataclasses import replace
from uuid import uuid4

import numpy as np
import pytest
from example_counts import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.core.rows import SampleBins
from service.errors import BusyError, ConflictError, NotFoundError
from service.ports.archive import LIVE, ListPart, Outcome
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
from service.records.levels.attitude import NO_ANGLES, AppliedCommand, Axes, CarrierResults, Status
from service.records.operations.work import Job, JobKind, JobState, Replay
from service.records.storage import Checkpoint

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


def test_a_job_is_followed_from_hand_to_hand(storage):
    results = storage.results
    for position in range(3):
        results.add_job(Job(f"job-{position}", "calibration", JobState.QUEUED, 0.0, 5))
    assert results.hold_job("job-1", "mine")
    assert not results.hold_job("job-1", "another")
    assert results.report_job("job-1", "mine", 0.1 + 0.2)
    assert not results.report_job("job-1", "another", 0.9)
    # the progress is stored, not computed: equal without tolerance
    assert results.job("job-1") == Job("job-1", "calibration", JobState.RUNNING, 0.1 + 0.2, 5)
    assert [job.id for job in results.open_jobs("another")] == ["job-0", "job-2"]
    results.let_go_of_job("job-1", "mine")
    assert results.hold_job("job-1", "another")
    assert results.free_jobs("another") == 0
    assert results.free_jobs("mine") == 1, "of processes that have ended"
    results.end_job("job-1")
    results.end_job("job-2", "the disk is full")
    assert not results.hold_job("job-2", "mine")
    assert [results.job(f"job-{k}").state.value for k in range(3)] == ["queued", "done", "failed"]
    assert results.job("job-2").error == "the disk is full"
    with pytest.raises(ConflictError) as caught:
        results.add_job(Job("job-1", "replay", JobState.QUEUED, 0.0, 5))
    assert caught.value.code == "job.exists"
    for call in (lambda: results.job("none"), lambda: results.end_job("none")):
        with pytest.raises(NotFoundError) as unknown:
            call()
        assert unknown.value.code == "job.unknown"


def test_jobs_are_done_in_order_of_their_kinds_and_those_of_persons_are_listed(storage):
    results = storage.results
    for at_us, kind in enumerate(("replay", "sealing", "calibration", "smoothing", "calibration")):
        results.add_job(Job(f"{kind}-{at_us}", kind, JobState.QUEUED, 0.0, at_us))
    order = ["calibration-2", "calibration-4", "smoothing-3", "sealing-1", "replay-0"]
    assert [job.id for job in results.open_jobs("mine")] == order
    assert [job.id for job in results.newest_jobs(2)] == ["calibration-4", "calibration-2"]
    assert [job.id for job in results.newest_jobs(9)] == ["calibration-4", "calibration-2", "replay-0"]


def test_standing_work_is_queued_anew_once_it_has_ended(storage):
    results, job = storage.results, Job("sealing-a", "sealing", JobState.QUEUED, 0.0, 5)
    results.queue_job(job)
    assert results.hold_job(job.id, "mine")
    assert results.report_job(job.id, "mine", 0.5)
    results.queue_job(job)
    assert results.job(job.id).progress == 0.5, "it is under way"
    results.end_job(job.id, "the disk is full")
    results.queue_job(job)
    assert results.job(job.id) == job


def test_a_draft_and_its_job_are_stored_together_and_fail_together(setting):
    results = setting.storage.results
    job = Job("c-1", "calibration", JobState.QUEUED, 0.0, 55, spacecraft_id=setting.id)
    arguments = (setting.id, REQUEST, 1, 1, 55, "engineer")
    draft = results.add_calibration(*arguments, job, 1)
    assert results.unfinished_job_of(setting.id, JobKind.CALIBRATION, str(draft.id)) == "c-1"
    with pytest.raises(BusyError):
        results.add_calibration(*arguments, replace(job, id="c-2"), 1)
    assert states(setting) == {1: "draft"}
    results.end_job("c-1", "no turns")
    assert states(setting) == {1: "failed"}
    assert results.calibration(setting.id, 1).error == "no turns"
    assert results.unfinished_job_of(setting.id, JobKind.CALIBRATION, "1") is None
    results.add_calibration(*arguments, replace(job, id="c-3"), 1)
    results.finish_calibration(setting.id, 2, RESULT, None)
    results.end_job("c-3", "late")
    assert results.calibration(setting.id, 2).result == RESULT


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
        lambda: results.attitude_rows(setting.id, gone, Method.ROBUST, ListPart(make.ever, 9)),
        lambda: results.commands(setting.id, gone, ListPart(make.ever, 9)),
        lambda: list(results.sampled_attitude(setting.id, gone, Method.ROBUST, make.ever, HOURS)),
        lambda: list(results.sampled_carriers(setting.id, gone, Method.ROBUST, make.ever, HOURS)),
        lambda: list(results.sampled_impulse(setting.id, gone, make.ever, HOURS)),
    )
    assert {code_of(call) for call in calls} == {"replay.unknown"}
    assert code_of(lambda: setting.consume(written, gone)) == "replay.deleted"
    assert [each.replay.version for each in results.replays(setting.id, EVER, 9, 0)] == [kept]
    assert sum(results.drop_replays(setting.id, None)) == 6
    assert list(results.drop_replays(setting.id, None)) == []
    assert len(results.attitude_rows(setting.id, kept, Method.ROBUST, ListPart(make.ever, 9))) == 3
    assert len(results.commands(setting.id, kept, ListPart(make.ever, 9))) == 3
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
        patch.setattr("db.results.results.store_checkpoint", killed)
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


BOTH = (Method.ROBUST, Method.PAPER)
NAN = float("nan")


def reasons(setting, make, method):
    rows = setting.storage.results.attitude_rows(setting.id, LIVE, method, ListPart(make.ever, 99))
    return [row.inhibitions for row in rows]


def outcomes(setting, make, methods=BOTH):
    return [Outcome(tuple(make.attitude_row(row, method) for method in methods), None) for row in setting.rows()]


FIGURES = ("attitude_deg", "sigma_deg", "rates_deg_s", "protection_deg")
SINGLES = ("downlink_fade_db", "common_db", "residual_rms_db", "lag_s")


@settings(
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    max_examples=examples(40),
)
@given(
    figures=st.lists(st.floats(), min_size=16, max_size=16),
    has_rates=st.booleans(),
    claims=st.lists(st.booleans(), min_size=5, max_size=5),
    status=st.sampled_from(Status),
)
def test_an_attitude_row_comes_back_bit_for_bit(new_setting, make, figures, has_rates, claims, status):
    setting = new_setting()
    setting.append([10])
    axes = {name: Axes(*figures[3 * k : 3 * k + 3]) for k, name in enumerate(FIGURES)}
    if not has_rates:
        axes["rates_deg_s"] = None
    row = make.attitude_row(
        setting.rows()[0],
        **axes,
        **dict(zip(SINGLES, figures[12:], strict=True)),
        status=status,
        control_allowed=claims[0],
        control_allowed_axes=tuple(claims[1:4]),
        downlink_fade=claims[4],
    )
    setting.consume([Outcome((row,), None)])
    stored = setting.storage.results.newest_attitude(setting.id, LIVE, Method.ROBUST)

    def bits(record):
        values = [value for name in FIGURES for value in getattr(record, name) or ()]
        values += [getattr(record, name) for name in SINGLES]
        return np.array([math.nan if math.isnan(value) else value for value in values]).tobytes()

    assert bits(stored) == bits(row)
    blank = dict.fromkeys((*FIGURES, *SINGLES))
    assert replace(stored, **blank) == replace(row, **blank)
    assert (stored.rates_deg_s is None) == (not has_rates)


def test_a_command_comes_back_equal(setting, make):
    setting.append([10])
    command = make.torque_command(setting.rows()[0], torque_n_m=Axes(-0.0, 1e-300, 0.1), wheels_n_m=(0.1 + 0.2, -0.0))
    setting.consume([Outcome((), command)])
    stored = setting.storage.results.newest_command(setting.id, LIVE)
    assert stored == command
    # equality does not see the sign of zero
    assert math.copysign(1.0, stored.torque_n_m.yaw) == math.copysign(1.0, stored.wheels_n_m[1]) == -1.0


def test_a_row_stored_once_stays_as_it_is(setting, make):
    setting.append([10])
    (measured,) = setting.rows()
    first, second = make.attitude_row(measured), make.attitude_row(measured, common_db=9.0)
    assert setting.consume([Outcome((first, first), None)]) == 1
    assert setting.consume([Outcome((second,), None)]) == 1
    assert setting.storage.results.newest_attitude(setting.id, LIVE, Method.ROBUST) == first


def test_sequences_follow_the_order_of_making_without_gaps(setting, make):
    results = setting.storage.results
    setting.append([10, 20])
    first, second = setting.rows()
    command = make.torque_command(first)
    rows = [make.attitude_row(first, method) for method in BOTH]
    assert setting.consume([Outcome(tuple(rows), command)]) == 3
    later = make.attitude_row(second)
    assert setting.consume([Outcome((rows[0], later), command)]) == 4
    assert results.results_after(setting.id, 0, 99) == [(1, rows[0]), (2, rows[1]), (3, command), (4, later)]
    assert results.results_after(setting.id, 1, 2) == [(2, rows[1]), (3, command)]
    assert results.results_after(setting.id, 4, 99) == []
    assert setting.storage.archive.head(setting.id).result_sequence == 4


def test_only_the_live_version_counts_and_moves_the_head(setting, make):
    setting.append([10])
    (measured,) = setting.rows()
    command = make.torque_command(measured)
    replayed = Outcome((make.attitude_row(measured),), command, AppliedCommand(command))
    assert setting.consume([replayed], "replay-1") == 0
    assert setting.consume([replayed], "replay-1") == 0
    head = setting.storage.archive.head(setting.id)
    assert (head.newest_number, head.consumed_number, head.result_sequence) == (4, 0, 0)
    results = setting.storage.results
    assert results.attitude_rows(setting.id, "replay-1", Method.ROBUST, ListPart(make.ever, 9)) == [replayed.rows[0]]
    assert results.newest_attitude(setting.id, "replay-1", Method.ROBUST) == replayed.rows[0]
    assert results.newest_attitude(setting.id, "replay-1", Method.PAPER) is None
    assert results.commands(setting.id, "replay-1", ListPart(make.ever, 9)) == [command]
    assert results.newest_attitude(setting.id, LIVE, Method.ROBUST) is None
    assert results.newest_command(setting.id, LIVE) is None
    assert results.results_after(setting.id, 0, 9) == []


def test_an_applied_command_enters_the_journal_once(setting, make):
    setting.append([10])
    command = make.torque_command(setting.rows()[0])
    applied = Outcome((), command, AppliedCommand(command))
    setting.consume([applied])
    setting.consume([applied])
    entries = setting.storage.archive.journal(setting.id, 4, 99)
    assert [(entry.number, entry.content) for entry in entries] == [(5, AppliedCommand(command))]


def test_the_head_never_moves_back(setting):
    setting.append([10, 20])
    setting.consume()
    setting.storage.results.save_outcomes(setting.id, LIVE, [], 2, 5)
    setting.storage.results.save_outcomes(setting.id, LIVE, [], 3, None)
    head = setting.storage.archive.head(setting.id)
    assert (head.consumed_number, head.consumed_epoch_us) == (5, 20)


def test_rows_that_were_not_computed_tell_why(setting, make):
    """Numbers: 4 row, 5 paper activation, 6 row, 7 geometry activation, 8 row, 9 alignment, 10 row."""
    setting.append([10])
    setting.calibrate(CalibrationMethod.PAPER)
    setting.append([20])
    setting.calibrate(CalibrationMethod.GEOMETRY)
    setting.append([30])
    setting.align(25)
    setting.append([40])
    setting.consume()
    assert reasons(setting, make, Method.ROBUST) == [("no_calibration",)] * 2 + [("not_aligned",)] * 2
    assert reasons(setting, make, Method.PAPER) == [("no_calibration",)] + [("not_aligned",)] * 3
    row = setting.storage.results.newest_attitude(setting.id, LIVE, Method.ROBUST)
    assert (row.epoch_us, row.number, row.received_at_us, row.status) == (40, 10, 77, Status.INVALID)
    assert all(math.isnan(angle) for angle in (*row.attitude_deg, *row.sigma_deg))
    assert (row.control_allowed, row.carriers_used, row.calibration_id, row.alignment_id) == (False, 0, None, None)


def test_a_geometry_calibration_serves_the_paper_method_too(setting, make):
    setting.calibrate(CalibrationMethod.GEOMETRY)
    setting.append([10])
    setting.consume()
    assert reasons(setting, make, Method.PAPER) == [("not_aligned",)]


def test_there_is_one_row_a_consumed_measurement_of_the_prime_source(setting, make):
    results = setting.storage.results
    setting.append([30, 10, 20])
    setting.append([15], source="sa-2")
    computed = [make.attitude_row(row) for row in setting.rows() if row.epoch_us == 20]
    setting.consume([Outcome(tuple(computed), None)])
    setting.append([40])
    rows = results.attitude_rows(setting.id, LIVE, Method.ROBUST, ListPart(make.ever, 99))
    assert [(row.epoch_us, row.number, row.status) for row in rows] == [
        (10, 5, Status.INVALID),
        (20, 6, Status.ACQUIRED),
        (30, 4, Status.INVALID),
    ]
    # repr, because NaN is not equal to itself
    assert repr(results.newest_attitude(setting.id, LIVE, Method.ROBUST)) == repr(rows[-1])


def test_the_newest_row_takes_one_statement_and_is_the_last_of_the_history(setting, make, monkeypatch):
    setting.append([10, 20, 30])
    setting.consume(outcomes(setting, make))
    results = setting.storage.results
    last = results.attitude_rows(setting.id, LIVE, Method.ROBUST, ListPart(make.ever, 99))[-1]
    with monkeypatch.context() as patch:
        patch.setattr("db.results.results.AttitudeReader", None)
        assert results.newest_attitude(setting.id, LIVE, Method.ROBUST) == last
    # the row of a newer measurement was not computed: the search finds it
    setting.append([40])
    setting.consume([])
    assert results.newest_attitude(setting.id, LIVE, Method.ROBUST).epoch_us == 40


@pytest.mark.parametrize("version", [LIVE, "replay-1"])
def test_pages_of_attitude_and_commands_join(setting, make, version):
    results = setting.storage.results
    setting.append([30, 10, 20, 40])
    made = [Outcome((make.attitude_row(row),), make.torque_command(row)) for row in setting.rows()]
    setting.consume(made, version)
    rows, commands, after = [], [], None
    while page := results.attitude_rows(setting.id, version, Method.ROBUST, ListPart(Window(10, 40), 2, after)):
        rows += page
        after = (page[-1].epoch_us, page[-1].number)
    after = None
    while page := results.commands(setting.id, version, ListPart(Window(10, 40), 2, after)):
        commands += page
        after = (page[-1].epoch_us, page[-1].number)
    assert [row.epoch_us for row in rows] == [command.epoch_us for command in commands] == [10, 20, 30]
    assert results.newest_command(setting.id, version).epoch_us == 40


def test_pending_counts_rows_after_the_alignment_without_a_result_of_every_method(setting, make):
    def pending(*methods):
        return setting.storage.results.pending(setting.id, methods)

    setting.append([10, 20, 30])
    setting.append([35], source="sa-2")
    assert pending(*BOTH) == 0
    setting.calibrate()
    setting.align(10)
    assert pending(*BOTH) == pending(Method.ROBUST) == 2
    assert pending() == 0
    rows = outcomes(setting, make, (Method.ROBUST,))
    # while the alignment is under way results are stored and nothing counts as consumed
    setting.storage.results.save_outcomes(setting.id, LIVE, rows[1:2], 0, None)
    assert (pending(Method.ROBUST), pending(Method.PAPER), pending(*BOTH)) == (1, 2, 2)
    setting.consume(outcomes(setting, make))
    assert pending(*BOTH) == 0
    setting.append([15, 40])
    assert pending(*BOTH) == 2
    setting.consume(outcomes(setting, make))
    assert pending(*BOTH) == 0
    setting.align(5)
    setting.append([6, 4])
    assert pending(*BOTH) == 1


def test_rows_after_an_alignment_are_computed_by_it_or_stay(setting, make):
    def rows_after(alignment):
        by_method = {**alignment.calibration_by_method, Method.ROBUST.value: 1, Method.PAPER.value: 1}
        return setting.storage.results.rows_after(setting.id, replace(alignment, calibration_by_method=by_method))

    setting.append([10, 20, 30])
    setting.calibrate()
    first = setting.align(10)
    assert rows_after(first) == (2, 0)
    made = outcomes(setting, make)
    setting.consume([aligned(outcome, first.id) for outcome in made])
    # computed meanwhile, and told all the same
    assert rows_after(first) == (2, 0)
    again = setting.align(10)
    assert rows_after(again) == (0, 2)
    setting.append([25])
    later = setting.align(20)
    assert rows_after(later) == (1, 1)


def aligned(outcome, alignment_id):
    return replace(outcome, rows=tuple(replace(row, alignment_id=alignment_id) for row in outcome.rows))


def test_outcomes_of_a_long_catch_up_are_stored_once(setting, make):
    epochs_us = list(range(1, 701))
    setting.append(epochs_us)
    made = outcomes(setting, make)
    assert setting.consume(made[:300]) == 600
    assert setting.consume(made) == 1400
    numbers = [number for number, _ in setting.storage.results.results_after(setting.id, 0, 5000)]
    assert numbers == list(range(1, 1401))
