"""Calibration jobs: drafts end with a result or with the reason why not."""

import threading
from dataclasses import replace
from unittest.mock import patch

import pytest

import service.runtime.jobs.calibration_job as calibrating
from service.errors import BusyError, ConflictError, InvalidInputError, NotFoundError
from service.records.calibration import CalibrationMethod, CalibrationState, Window
from service.records.inputs import PolarizationRecord, TelemetryRecord
from service.records.operations.job import JobState
from service.runtime.jobs.job_runner import JobAbortedError


@pytest.fixture
def ground(new_ground):
    """A station; no alignment is needed."""
    return new_ground()


@pytest.fixture
def seen():
    """Inputs that the job hands to the fits, in order; the fits themselves run."""
    found, fit = [], calibrating.calibrate_paper

    def fitted(data, config):
        found.append(data)
        return fit(data, config)

    with patch.object(calibrating, "calibrate_paper", side_effect=fitted):
        yield found


def run(ground, request):
    draft, job = ground.calibrator.start(ground.id, request, "engineer")
    assert (draft.state, draft.created_by) == (CalibrationState.DRAFT, "engineer")
    ground.finish(job.id)
    return ground.storage.results.calibration(ground.id, draft.id), ground.storage.results.job(job.id)


def test_a_fit_ends_with_a_result_that_can_be_activated(ground):
    calibration, job = run(ground, ground.payload.request)
    assert job.state is JobState.DONE
    assert [carrier.id for carrier in calibration.result.carriers] == list(ground.payload.ids)
    active = ground.calibrator.activate(ground.id, calibration.id)
    assert active.state is CalibrationState.ACTIVE
    assert ground.calibrator.activate(ground.id, calibration.id) == active
    assert ground.storage.results.calibration(ground.id, 1).state is CalibrationState.SUPERSEDED


def test_windows_without_what_is_needed_fail_with_the_same_text_in_job_and_calibration(ground):
    calibration, job = run(ground, replace(ground.payload.request, turns=Window(0, 1)))
    assert job.state is JobState.FAILED
    assert job.error == calibration.error
    assert "the window of turns holds 0 measurements" in job.error
    assert calibration.state is CalibrationState.FAILED
    with pytest.raises(ConflictError, match="the window of turns holds 0 measurements"):
        ground.calibrator.activate(ground.id, calibration.id)


def test_a_fault_of_the_fit_fails_calibration_and_job(ground):
    with patch.object(calibrating, "calibrate_paper", side_effect=ZeroDivisionError("x")):
        calibration, job = run(ground, ground.payload.request)
    assert calibration.error == "internal error: ZeroDivisionError('x')"
    assert "ZeroDivisionError" in job.error


def test_a_calibration_by_geometry_says_what_its_windows_lack(ground):
    """The archive of this station has readings of the turns alone."""
    geometry = replace(ground.payload.request, method=CalibrationMethod.GEOMETRY)
    calibration, job = run(ground, geometry)
    assert (calibration.state, job.state) == (CalibrationState.FAILED, JobState.FAILED)
    assert "only 1 rows of the quiet window have angles of star_tracker" in job.error


@pytest.mark.parametrize("fails", [False, True])
def test_a_draft_names_its_job_until_that_has_ended(ground, fails):
    named = []
    fit = calibrating.calibrate_paper

    def fitted(data, config):
        named.append(ground.calibrator.job_id(ground.id, 2))
        if fails:
            raise ZeroDivisionError
        return fit(data, config)

    with patch.object(calibrating, "calibrate_paper", side_effect=fitted):
        calibration, job = run(ground, ground.payload.request)
    assert (calibration.id, named) == (2, [job.id])
    assert ground.calibrator.job_id(ground.id, 2) is None


def test_measured_motion_of_the_turns_reaches_the_fit(ground, seen):
    turns = ground.payload.request.turns
    inside, outside = turns.start_us + 60_000_000, turns.stop_us
    ground.storage.archive.append_inputs(ground.id, [TelemetryRecord(at_us, "hold") for at_us in (inside, outside)])
    told = [PolarizationRecord("p", at_us, angle_deg=0.3, sigma_deg=0.1) for at_us in (inside, outside)]
    ground.storage.archive.append_inputs(ground.id, told)
    run(ground, ground.payload.request)
    ((telemetry,), (angle,)) = seen[0].telemetry, seen[0].polarization
    assert (telemetry.epoch_us, angle) == (inside, told[0])


def test_of_quiet_days_it_is_given_telemetry_a_minute_apart_and_unloadings(ground, seen):
    quiet = ground.payload.request.quiet
    told = [TelemetryRecord(quiet.start_us + 20_000_000 * k, "hold", thrusters_active=k == 4) for k in range(25)]
    ground.storage.archive.append_inputs(ground.id, told)
    # four records a page: pages end within a minute and between minutes
    with patch.object(calibrating, "_MAX_RECORDS", 4):
        run(ground, ground.payload.request)
    seconds = [(one.epoch_us - quiet.start_us) // 1_000_000 for one in seen[0].telemetry]
    # the unloading at 80 s begins the next minute
    assert seconds == [0, 60, 80, 140, 200, 260, 320, 380, 440]


def test_of_quiet_days_it_is_given_angles_of_each_polarimeter_a_minute_apart(ground, seen):
    quiet = ground.payload.request.quiet
    told = [
        PolarizationRecord(source, quiet.start_us + 20_000_000 * k, ratio_db=-15.0) for k in range(7) for source in "pq"
    ]
    ground.storage.archive.append_inputs(ground.id, told)
    with patch.object(calibrating, "_MAX_RECORDS", 4):
        run(ground, ground.payload.request)
    seconds = [(one.source, (one.epoch_us - quiet.start_us) // 1_000_000) for one in seen[0].polarization]
    assert seconds == [(source, second) for second in (0, 60, 120) for source in "pq"]


def test_a_stop_of_the_service_is_not_called_an_internal_error(ground):
    with patch.object(calibrating, "calibrate_paper", side_effect=JobAbortedError("the service is stopping")):
        calibration, job = run(ground, ground.payload.request)
    assert calibration.error == job.error == "the service is stopping"


def test_a_draft_cannot_be_activated(ground):
    draft = ground.storage.results.add_calibration(ground.id, ground.payload.request, 1, 1, 0, "engineer")
    with pytest.raises(ConflictError, match="its job has not ended"):
        ground.calibrator.activate(ground.id, draft.id)


def test_what_cannot_begin_is_refused_at_once(ground):
    with pytest.raises(NotFoundError):
        ground.calibrator.start("nobody", ground.payload.request, "engineer")


def test_only_so_many_wait_and_leaving_makes_room(ground):
    may_go = threading.Event()

    def fit(_data):
        assert may_go.wait(60)
        raise InvalidInputError("analysis.too_long", "it was ended after 600 s of computing")

    calibrator = calibrating.Calibrator(ground.storage, ground.clock, ground.jobs, fit, 2)
    started = [calibrator.start(ground.id, ground.payload.request, "engineer") for _ in range(2)]
    with pytest.raises(BusyError, match=r"analysis\.busy: 2 calibrations wait or run already"):
        calibrator.start(ground.id, ground.payload.request, "engineer")
    may_go.set()
    for draft, job in started:
        assert ground.finish(job.id) is JobState.FAILED
        stored = ground.storage.results.calibration(ground.id, draft.id)
        assert (stored.state, stored.error) == (
            CalibrationState.FAILED,
            "analysis.too_long: it was ended after 600 s of computing",
        )
    assert calibrator.start(ground.id, ground.payload.request, "engineer")
