"""Jobs: every one ends and says how; alignment, calibration and upkeep from what the archive stores."""

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
from synthetic_payload import HOUR, START_US, SyntheticPayload

import service.runtime.jobs.calibration as calibrating
from service.api.schemas.calibrations import AlignmentAnswer
from service.errors import BusyError, ConflictError, InvalidInputError, NotFoundError, StorageError
from service.records.calibration import CalibrationMethod, CalibrationState, Window
from service.records.catalogue import Method, Onboard
from service.records.inputs import PolarizationRecord, TelemetryRecord
from service.records.levels.attitude import Axes
from service.records.operations.work import Job, JobKind, JobState
from service.records.storage import (
    SERIES,
    RetentionConfig,
    RetiredRows,
    SealedPart,
    SealedResults,
    SealingConfig,
)
from service.runtime.jobs.archive_maintenance import MaintenanceDue, MaintenanceWork, runnable_methods
from service.runtime.jobs.calibration import AlignmentRequest

TRACKER = ("star_tracker",) * 3
SIGMA = Axes(0.02, 0.01, 0.01)


@pytest.fixture
def ground(new_ground):
    """A station that is calibrated but not aligned."""
    return new_ground()


def by_hand(at_us, angles=(0.0, 0.0, 0.0), reason=None):
    return AlignmentRequest(None, None, (at_us, Axes(*angles), SIGMA), reason, "approver")


def test_a_window_of_the_star_tracker_gives_angles_and_references(ground):
    found = ground.align()
    assert found.epoch_us == ground.alignment_window.stop_us - ground.synthetic.MINUTE
    np.testing.assert_allclose(found.attitude_deg, 0.0, atol=1e-12)  # the tracker of this day reads zero
    assert (found.calibration_id, found.source, found.created_by) == (1, "star_tracker", "operator")
    assert {item.samples for item in found.references} == {30}
    reference = [item.reference_dbm for item in found.references]
    # mean of thirty rows of 0.05 dB, and the harmonic's own error of two days: six sigma
    np.testing.assert_allclose(reference, ground.payload.level_dbm, atol=0.06)
    assert ground.storage.results.alignments(ground.id) == (found,)


def test_angles_stated_by_hand_take_the_powers_before_them(ground):
    found = ground.aligner.align(ground.id, by_hand(ground.at(0)))
    assert (found.epoch_us, found.source, found.sigma_deg) == (ground.at(0), "manual", SIGMA)
    assert found.window == Window(ground.at(-15), ground.at(0) + 1)
    assert {item.samples for item in found.references} == {16}


@pytest.mark.parametrize("coupling", [True, False, None])
def test_an_exchange_of_roll_and_yaw_that_nobody_stated_is_warned_of(ground, coupling):
    record = ground.storage.catalogue.spacecraft(ground.id)
    ground.storage.catalogue.replace_spacecraft(replace(record, onboard=Onboard(roll_yaw_coupling=coupling)))
    warnings = ground.align().warnings
    assert len(warnings) == (coupling is None)
    assert all("onboard.roll_yaw_coupling" in warning for warning in warnings)
    # it is kept with the alignment, whatever the catalogue says later
    ground.storage.catalogue.replace_spacecraft(replace(record, onboard=Onboard(roll_yaw_coupling=True)))
    assert ground.storage.results.alignments(ground.id)[0].warnings == warnings
    assert AlignmentAnswer.of(ground.storage.results.alignments(ground.id)[0]).warnings == list(warnings)


def test_powers_that_contradict_are_refused_with_what_they_tell_unless_overridden(ground):
    with pytest.raises(ConflictError) as caught:
        ground.aligner.align(ground.id, by_hand(ground.at(0), (0.0, 0.5, -0.5)))
    assert caught.value.code == "alignment.inconsistent"
    assert "roll -0." in caught.value.detail
    assert ground.storage.results.alignments(ground.id) == ()
    forced = ground.aligner.align(ground.id, by_hand(ground.at(0), (0.0, 0.5, -0.5), "sensor was re-mounted"))
    assert forced.override_reason == "sensor was re-mounted"


def refused(ground, request, kind=InvalidInputError):
    with pytest.raises(kind) as caught:
        ground.aligner.align(ground.id, request)
    return caught.value.code, caught.value.detail


def test_a_window_without_references(ground):
    empty = Window(ground.at(100), ground.at(130))
    code, detail = refused(ground, AlignmentRequest(empty, TRACKER, None, None, "operator"))
    assert code == "alignment.no_reference"
    assert detail.startswith("no yaw and roll and pitch of star_tracker between")


def test_a_window_without_powers(ground):
    code, detail = refused(ground, by_hand(ground.at(500)))
    assert code == "alignment.no_powers"
    assert detail.startswith("0 carriers have 8 rows or more between")


def test_neither_a_window_nor_angles(ground):
    code, _ = refused(ground, AlignmentRequest(ground.alignment_window, None, None, None, "operator"))
    assert code == "alignment.shape"


def test_without_an_active_calibration(ground):
    storage = ground.storage
    storage.catalogue.add_spacecraft(
        type(ground.payload.spacecraft())(
            "fresh", "Fresh", 90.0, ground.payload.spacecraft().receiving_site, ground.synthetic.INERTIA, 0.05
        )
    )
    with pytest.raises(ConflictError, match="no calibration of fresh is active"):
        ground.aligner.align("fresh", by_hand(ground.at(0)))
    with pytest.raises(NotFoundError):
        ground.aligner.align("nobody", by_hand(ground.at(0)))


PAYLOAD = SyntheticPayload.make(6)


@pytest.mark.parametrize(
    ("named", "methods"),
    [
        ({"robust": 3, "paper": 3}, {Method.ROBUST, Method.PAPER}),
        ({"robust": 3}, {Method.ROBUST}),
        ({"paper": 3}, {Method.PAPER}),
        ({}, {Method.PAPER}),
        (None, set()),
    ],
)
def test_methods_that_the_alignment_started_run(named: dict[str, int] | None, methods: set[Method]) -> None:
    alignment = PAYLOAD.alignment(START_US + HOUR)
    stored = () if named is None else (replace(alignment, calibration_by_method=named),)
    assert set(runnable_methods(stored)) == methods


DAY_US = 86_400_000_000
NOW_US = 20_000 * DAY_US
PART = SealedPart("sa-1", 1, NOW_US - DAY_US, NOW_US, 10, 10)
FAST = SealingConfig(quiet_s=900.0, period_s=0.01, pause_s=0.0)


class Archive:
    """Records what it is asked; seals one part and drops two rows each time."""

    def __init__(self):
        self.asked, self.faults, self.fitting, self.results = [], {}, None, Results()

    def seal(self, name, before_us, received_before_us):
        self.asked.append(("seal", name, before_us, received_before_us))
        if name in self.faults:
            raise self.faults.pop(name)
        yield PART

    def drop_before(self, name, series, before_us):
        self.asked.append(("drop", series, before_us))
        yield RetiredRows(series, 2, before_us)

    def drop_replays(self, name, created_before_us):
        if created_before_us is not None:
            self.asked.append(("replays", name, created_before_us))
            yield 7

    def fitting_us(self, name, series, size_bytes):
        self.asked.append(("fit", series, size_bytes))
        return self.fitting


class Results:
    """Seals results of a replay each time; keeps until when."""

    def __init__(self):
        self.before_us = []

    def seal(self, _name, before_us):
        self.before_us.append(before_us)
        yield SealedResults("attitude", "replay-1", "paper", NOW_US - DAY_US, 7, 9)


class Clock:
    def __init__(self, now_us=NOW_US):
        self.now = now_us

    def now_us(self, _name):
        return self.now

    def system_us(self):
        return NOW_US + 5


@pytest.fixture
def archive():
    return Archive()


def maintainer(archive, retention=None, clock=None, names=("a",)):
    catalogue = SimpleNamespace(all_spacecraft=lambda: [SimpleNamespace(id=name) for name in names])
    archive.results.drop_replays = archive.drop_replays
    storage = SimpleNamespace(catalogue=catalogue, archive=archive, results=archive.results)
    return MaintenanceWork(storage, clock or Clock(), FAST, retention or RetentionConfig())


def test_days_are_sealed_after_the_quiet_time_and_nothing_is_dropped_by_default(archive):
    made = maintainer(archive)
    made.do_all()
    quiet_us = 900_000_000
    assert archive.asked == [("seal", "a", NOW_US - quiet_us, NOW_US + 5 - quiet_us)]
    assert archive.results.before_us == [NOW_US - quiet_us]
    assert (made.sealed_rows, made.sealed_results) == (10, 7)
    assert set(made.dropped_rows.values()) == {0}


def test_versions_are_dropped_by_the_age_of_the_replay(archive):
    made = maintainer(archive, RetentionConfig(replays_days=2.0))
    made.do_all()
    assert archive.asked[0] == ("replays", "a", NOW_US + 5 - 2 * DAY_US)
    assert made.dropped_rows["replays"] == 7


def test_series_are_dropped_by_age_and_by_size(archive, monkeypatch):
    archive.fitting = NOW_US - 3 * DAY_US
    made = maintainer(archive, RetentionConfig(measurements_days=30.0, attitude_bytes=1000))
    made.do_all()
    assert archive.asked[:3] == [
        ("drop", "measurements", NOW_US - 30 * DAY_US),
        ("fit", "attitude", 1000),
        ("drop", "attitude", NOW_US - 3 * DAY_US),
    ]
    assert {name: rows for name, rows in made.dropped_rows.items() if rows} == {"measurements": 2, "attitude": 2}
    archive.asked.clear()
    made.do_all()
    assert ("fit", "attitude", 1000) not in archive.asked, "sizes are looked at once an hour"
    monkeypatch.setattr("service.runtime.jobs.archive_maintenance.SIZING_S", 0.0)
    archive.fitting = None
    made.do_all()
    assert ("fit", "attitude", 1000) in archive.asked
    assert not [asked for asked in archive.asked if asked[:2] == ("drop", "attitude")]


@pytest.mark.parametrize("series", SERIES)
def test_every_series_has_its_age(archive, series):
    maintainer(archive, RetentionConfig(**{f"{series}_days": 1.5})).do_all()
    assert archive.asked[0] == ("drop", series, NOW_US - 3 * DAY_US // 2)


def test_a_clock_that_knows_no_time_yet_seals_nothing(archive):
    maintainer(archive, clock=Clock(None)).do_all()
    assert archive.asked == []


def test_a_fault_of_one_spacecraft_is_logged_and_keeps_no_other_from_its_turn(archive, caplog):
    archive.faults["a"] = StorageError("storage.unavailable", "the disk is full")
    made = maintainer(archive, names=("a", "b"))
    assert made.do_all() == 1
    assert [asked[1] for asked in archive.asked] == ["a", "b"]
    assert "the disk is full" in caplog.text
    made.do_all()
    assert made.sealed_rows == 30


def test_every_spacecraft_that_is_led_is_looked_at_once_a_period_and_the_archive(archive, monkeypatch):
    archive.heads = lambda: dict.fromkeys("abc")
    now_s = [100.0]
    monkeypatch.setattr("service.runtime.jobs.archive_maintenance.time.monotonic", lambda: now_s[0])
    due = MaintenanceDue(SimpleNamespace(archive=archive), SealingConfig(period_s=60.0), lambda name: name != "b")
    assert list(due.due()) == []
    now_s[0] += 60.0
    assert list(due.due()) == ["a", "c", ""]
    assert list(due.due()) == []


def test_a_job_is_the_work_of_one_spacecraft_or_of_the_service(archive):
    work = maintainer(archive, names=("a", "b"))
    assert len(list(work(Job("sealing-b", "sealing", JobState.RUNNING, 0.0, 0, spacecraft_id="b")))) == 2
    assert [asked[1] for asked in archive.asked] == ["b"]
    assert list(work(Job("sealing-service", "sealing", JobState.RUNNING, 0.0, 0, spacecraft_id=""))) == []


def test_alarms_and_notes_are_dropped_by_age_of_each_spacecraft_and_of_the_service(archive):
    asked = []

    def log(kind):
        def drop_before(name, before_us):
            asked.append((kind, name, before_us))
            yield 3

        return SimpleNamespace(drop_before=drop_before)

    work = maintainer(archive, RetentionConfig(alarms_days=2.0, notes_days=1.0))
    work._storage.alarms, work._storage.notes = log("alarms"), log("notes")
    work.do_all()
    of_service = [("alarms", None, NOW_US + 5 - 2 * DAY_US), ("notes", None, NOW_US + 5 - DAY_US)]
    assert asked == [("alarms", "a", NOW_US - 2 * DAY_US), ("notes", "a", NOW_US - DAY_US), *of_service]
    assert (work.dropped_rows["alarms"], work.dropped_rows["notes"]) == (6, 6)


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
    # as text: figures that are not known are equal
    assert repr(ground.calibrator.activate(ground.id, calibration.id)) == repr(active)
    assert ground.storage.results.calibration(ground.id, 1).state is CalibrationState.SUPERSEDED


def test_windows_without_what_is_needed_fail_with_the_same_text_in_job_and_calibration(ground):
    calibration, job = run(ground, replace(ground.payload.request, turns=Window(0, 1)))
    assert job.state is JobState.FAILED
    assert job.error == calibration.error
    assert "the window of turns holds 0 measurements" in job.error
    assert calibration.state is CalibrationState.FAILED
    with pytest.raises(ConflictError, match="the window of turns holds 0 measurements"):
        ground.calibrator.activate(ground.id, calibration.id)


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
        named.append(ground.storage.results.unfinished_job_of(ground.id, JobKind.CALIBRATION, "2"))
        if fails:
            raise ZeroDivisionError
        return fit(data, config)

    with patch.object(calibrating, "calibrate_paper", side_effect=fitted):
        calibration, job = run(ground, ground.payload.request)
    assert (calibration.id, named) == (2, [job.id])
    assert ground.storage.results.unfinished_job_of(ground.id, JobKind.CALIBRATION, "2") is None


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


def test_a_fault_of_the_fit_fails_calibration_and_job(ground):
    with patch.object(calibrating, "calibrate_paper", side_effect=ZeroDivisionError("x")):
        calibration, job = run(ground, ground.payload.request)
    assert calibration.error == job.error == "internal error, see the log: ZeroDivisionError('x')"


def test_a_draft_cannot_be_activated(ground):
    draft = ground.storage.results.add_calibration(ground.id, ground.payload.request, 1, 1, 0, "engineer")
    with pytest.raises(ConflictError, match="its job has not ended"):
        ground.calibrator.activate(ground.id, draft.id)


def test_what_cannot_begin_is_refused_at_once(ground):
    with pytest.raises(NotFoundError):
        ground.calibrator.start("nobody", ground.payload.request, "engineer")


def test_only_so_many_wait_and_leaving_makes_room(ground):
    calibrator = calibrating.Calibrator(ground.storage, ground.clock, ground.jobs.notify, 2)
    started = [calibrator.start(ground.id, ground.payload.request, "engineer") for _ in range(2)]
    with pytest.raises(BusyError, match=r"analysis\.busy: 2 calibrations wait or run already"):
        calibrator.start(ground.id, ground.payload.request, "engineer")
    too_long = InvalidInputError("analysis.too_long", "it was ended after 600 s of computing")
    with patch.object(calibrating, "calibrate_paper", side_effect=too_long):
        for draft, job in started:
            assert ground.finish(job.id) is JobState.FAILED
            stored = ground.storage.results.calibration(ground.id, draft.id)
            assert (stored.state, stored.error) == (
                CalibrationState.FAILED,
                "analysis.too_long: it was ended after 600 s of computing",
            )
    assert calibrator.start(ground.id, ground.payload.request, "engineer")


def test_a_refused_calibration_leaves_no_draft(ground):
    calibrator = calibrating.Calibrator(ground.storage, ground.clock, ground.jobs.notify, 1)
    draft, _ = calibrator.start(ground.id, ground.payload.request, "engineer")
    with pytest.raises(BusyError):
        calibrator.start(ground.id, ground.payload.request, "engineer")
    assert ground.storage.results.calibrations(ground.id)[0].id == draft.id
