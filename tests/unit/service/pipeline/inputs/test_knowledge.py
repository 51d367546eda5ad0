"""Inputs of sensors, polarisation and weather, and what is known of them."""

import math
from dataclasses import replace

import numpy as np
import pytest
import synthetic_payload as synthetic

from service.core.estimation.filtering.polarimeter import faraday_deg, ratio_db, slope_db_deg
from service.core.geometry.frames import body_from_nadir
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.knowledge import Knowledge, reported_wet, update, with_report
from service.pipeline.inputs.polarization import (
    due_block,
    every_block,
    line_of_sight,
    polarimeter_models,
    used_polarimeters,
    with_polarization_record,
)
from service.pipeline.inputs.sensor_angles import StatedAngles, angles_at, smooth_angles, stated_sigma_deg
from service.records.calibration import (
    Calibration,
    CalibrationMethod,
    CalibrationRequest,
    CalibrationResult,
    CalibrationState,
    FeedFit,
    MotionVerdict,
    PolarimeterCheck,
    Window,
)
from service.records.catalogue import Method, Polarimeter, Site, Spacecraft, Station
from service.records.inputs import (
    CalibrationActivation,
    Correction,
    Operation,
    PolarizationRecord,
    SourceSelection,
    TelemetryRecord,
    WeatherReport,
)
from service.records.levels.attitude import Axes
from service.records.levels.measurement import ReferenceSeries


@pytest.fixture
def documents(payload):
    """Documents of a spacecraft; calibration 2 is one by station geometry."""
    held = synthetic.FixedDocuments(payload, synthetic.START_US)
    request = replace(payload.request, method=CalibrationMethod.GEOMETRY)
    held.calibrations[2] = replace(payload.calibration(2), request=request)
    return held


@pytest.fixture
def knowledge(payload, documents):
    """What the opening of a journal tells."""
    known = Knowledge()
    for content in synthetic.opening(payload.spacecraft()):
        known = update(known, content, documents)
    return known


def test_the_opening_tells_everything(knowledge, payload):
    assert knowledge.spacecraft == payload.spacecraft()
    assert knowledge.plan.carrier_ids == payload.ids
    assert knowledge.ephemeris == payload.ephemeris()
    assert knowledge.alignment.id == 1
    assert knowledge.calibration_for(Method.PAPER).id == 1
    assert knowledge.calibration_for(Method.ROBUST) is None


def test_knowledge_before_is_not_changed_by_what_comes_after(knowledge, documents):
    later = update(knowledge, CalibrationActivation(2, 2), documents)
    assert knowledge.calibration_for(Method.ROBUST) is None
    assert later.calibration_for(Method.ROBUST).id == 2


def test_geometry_serves_paper_only_while_no_paper_one_is_active(documents, knowledge):
    alone = update(Knowledge(), CalibrationActivation(2, 1), documents)
    assert alone.calibration_for(Method.PAPER).id == 2
    both = update(knowledge, CalibrationActivation(2, 2), documents)
    assert both.calibration_for(Method.PAPER).id == 1


def test_nothing_is_known_before_the_first_input():
    assert Knowledge().calibration_for(Method.PAPER) is None


@pytest.mark.parametrize("content", [Correction(1, 2, Axes(0.1, 0.1, 0.1)), SourceSelection("sa-2", 1)])
def test_inputs_that_no_method_uses_yet_change_nothing(knowledge, documents, content):
    assert update(knowledge, content, documents) is knowledge


def test_reported_rain_belongs_to_the_carriers_of_the_station(knowledge, documents, payload):
    assert knowledge.reported_wet(payload.ids, 0) is None
    carriers = tuple(
        replace(carrier, station=Station(0.0, 0.0, name))
        for carrier, name in zip(
            knowledge.plan.carriers, ["Kyiv", "Kyiv", "Minsk", ""] * len(payload.ids), strict=False
        )
    )
    named = knowledge._replace(plan=replace(knowledge.plan, carriers=carriers))
    for report in (WeatherReport("radar", "Kyiv", 0, 4.0), WeatherReport("radar", "Minsk", 0, 0.0)):
        named = update(named, report, documents)
    np.testing.assert_array_equal(named.reported_wet([*payload.ids[:4], "c99"], 0), [1.0, 1.0, 0.0, np.nan, np.nan])


@pytest.mark.parametrize(
    ("changes", "at_us", "stands"),
    [
        ({}, 100, True),
        ({}, 99, False),
        ({}, 200, False),
        ({}, 199, True),
        ({"stop_us": None}, 10**18, True),
        ({"inhibit_control": False}, 150, False),
    ],
)
def test_an_operation_forbids_control_from_start_to_stop(documents, changes, at_us, stands):
    operation = replace(Operation(4, "eclipse", 100, 200, inhibit_control=True), **changes)
    known = update(Knowledge(), operation, documents)
    assert bool(known.inhibiting_operations(at_us)) == stands


@pytest.mark.parametrize(
    ("operations", "at_s", "stands"),
    [
        ((), 99, False),  # before the record
        ((), 100, True),
        ((), 699, True),
        ((), 700, False),  # too old
        (("station_keeping", 50, 150), 100, False),
        (("momentum_unloading", 50, None), 650, False),
        (("other", 50, 99), 100, True),  # over before the thrusters acted
        (("other", 120, 200), 110, True),  # not begun
        (("eclipse", 50, 150), 100, True),  # explains no thrust
    ],
)
def test_thrusters_that_act_without_a_declared_operation(documents, operations, at_s, stands):
    known = update(Knowledge(), TelemetryRecord(40 * S, thrusters_active=False), documents)
    known = update(known, TelemetryRecord(100 * S, thrusters_active=True), documents)
    known = update(known, TelemetryRecord(105 * S, onboard_mode="normal"), documents)
    if operations:
        kind, start_s, stop_s = operations
        operation = Operation(1, kind, start_s * S, None if stop_s is None else stop_s * S)
        known = update(known, operation, documents)
    assert known.is_thrusting_undeclared(at_s * S) == stands
    ended = update(known, TelemetryRecord(at_s * S, thrusters_active=False), documents)
    if at_s > 100:
        assert not ended.is_thrusting_undeclared(at_s * S)


def test_the_newest_revision_of_an_operation_holds(documents):
    first = Operation(4, "eclipse", 100, 200, inhibit_control=True)
    known = update(Knowledge(), first, documents)
    known = update(known, replace(first, stop_us=120, revision=2), documents)
    known = update(known, Operation(5, "other", 140, 160, inhibit_control=True), documents)
    assert [known.inhibiting_operations(t) != () for t in (110, 130, 150)] == [True, False, True]


S = 1_000_000
START_US = 1_800_000_000 * S
NAN = float("nan")


def series(source, epochs_us, angles, sigma=0.02):
    epochs = np.asarray(epochs_us, dtype=np.int64)
    reported = np.broadcast_to(np.asarray(angles, dtype=np.float64), (len(epochs), 3)).copy()
    return ReferenceSeries(source, epochs, reported, np.full((len(epochs), 3), sigma))


def test_a_line_is_read_at_the_newest_reference_with_its_sigma_and_slope():
    epochs_us = START_US + 60 * S * np.arange(31)
    minutes = np.arange(31.0)
    slopes = np.array([0.001, -0.002, 0.003])
    stated, missing = smooth_angles((series("st", epochs_us, minutes[:, None] * slopes),), ("st",) * 3)
    assert missing == ()
    assert stated.epoch_us == epochs_us[-1]
    # a straight line is found to rounding
    np.testing.assert_allclose(stated.attitude_deg, 30.0 * slopes, atol=1e-12)
    np.testing.assert_allclose(stated.rate_deg_s, slopes / 60.0, atol=1e-15)
    # the end of a line of n equal steps: variance (4 n + 2) / ((n + 1) (n + 2)) of one reading, n = 30 steps
    wanted = 0.02 * np.sqrt((4 * 30 + 2) / (31 * 32))
    np.testing.assert_allclose(stated.sigma_deg, wanted, rtol=1e-9)


def test_each_axis_has_its_own_sensor_and_all_are_read_at_one_epoch():
    beacon = series("beacon", START_US + 60 * S * np.arange(20), [0.3, NAN, NAN])
    earth = series("earth", START_US + 60 * S * np.arange(40), [NAN, 0.1, -0.2], sigma=NAN)
    stated, missing = smooth_angles((earth, beacon), ("beacon", "earth", "earth"))
    assert (missing, stated.epoch_us) == ((), START_US + 39 * 60 * S)
    np.testing.assert_allclose(stated.attitude_deg, [0.3, 0.1, -0.2], atol=1e-12)
    # read 20 minutes after its last reading a line is less certain; a sensor that states no sigma has 0.05
    assert stated.sigma_deg.yaw > 0.02
    assert stated.sigma_deg.roll == pytest.approx(0.05 * np.sqrt((4 * 39 + 2) / (40 * 41)), rel=1e-9)


def test_axes_that_nobody_saw_are_named():
    blind = series("earth", START_US + S * np.arange(9), [NAN, 0.1, NAN])
    stated, missing = smooth_angles((blind,), ("beacon", "earth", "earth"))
    assert stated is None
    assert missing == ("yaw", "pitch")
    assert smooth_angles((), ("a", "b", "c")) == (None, ("yaw", "roll", "pitch"))


@pytest.mark.parametrize(
    "epochs_us",
    [START_US + 60 * S * np.arange(7), np.full(9, START_US)],
    ids=["too few for a line", "all of one instant"],
)
def test_without_a_line_the_mean_is_taken(epochs_us):
    angles = np.linspace(0.0, 0.6, len(epochs_us))[:, None] * np.ones(3)
    stated, _ = smooth_angles((series("st", epochs_us, angles),), ("st",) * 3)
    np.testing.assert_allclose(stated.attitude_deg, 0.3, atol=1e-12)
    np.testing.assert_allclose(stated.sigma_deg, 0.02 / np.sqrt(len(epochs_us)), rtol=1e-12)
    assert stated.rate_deg_s == Axes(0.0, 0.0, 0.0)


def test_a_sigma_that_is_not_stated_is_the_usual_one():
    reported = stated_sigma_deg(StatedAngles(START_US, Axes(0, 0, 0), Axes(NAN, 0.01, NAN)))
    np.testing.assert_array_equal(reported, [0.05, 0.01, 0.05])


CONFIG = CalibrationConfig()
REACH_S = CONFIG.reference_reach_s
#: readings with a gap of ten reaches after the third
AT_S = np.array([0.0, REACH_S, 2.0 * REACH_S, 12.0 * REACH_S])


def angle_deg(seconds):
    """Return pitch at some rows, read by a sensor that says a degree a reach."""
    epochs_us = np.round(AT_S * 1e6).astype(np.int64)
    series = ReferenceSeries("gyro", epochs_us, np.tile(AT_S / REACH_S, (3, 1)).T, np.full((4, 3), 0.01))
    rows_us = np.round(np.asarray(seconds) * 1e6).astype(np.int64)
    return angles_at(rows_us, (series,), ("none", "none", "gyro"), CONFIG)


def test_a_row_between_readings_and_within_reach_of_either_has_an_angle():
    at_s = REACH_S * np.array([0.5, 1.9, 2.9, 11.1])
    assert angle_deg(at_s)[:, 2] == pytest.approx([0.5, 1.9, 2.9, 11.1])


def test_beyond_the_reach_of_both_neighbours_there_is_none():
    assert np.isnan(angle_deg(REACH_S * np.array([3.1, 7.0, 10.9]))[:, 2]).all()


def test_a_sensor_without_readings_has_no_angle():
    assert np.isnan(angle_deg([0.0, REACH_S])[:, :2]).all()


MINUTE_US = 60_000_000
STATED = Polarimeter("p", 10.0, 11e9)
CRAFT = Spacecraft("y", "Y", 49.0, Site(55.9, 38.0), np.diag([2600.0, 1400.0, 2600.0]).tolist(), 0.05)


def records(*rows):
    """Return records of rows (minute, angle), angles as ratios."""
    kept: dict[str, tuple[PolarizationRecord, ...]] = {}
    for minute, angle_deg in rows:
        ratio = ratio_db(10.0, angle_deg)
        kept = with_polarization_record(kept, PolarizationRecord("p", round(minute * MINUTE_US), ratio, -55.0))
    return kept["p"]


def test_the_line_of_sight_is_that_of_a_turned_body():
    sight = np.array(line_of_sight(CRAFT, STATED))
    assert np.linalg.norm(sight) == pytest.approx(1.0)
    # the station stands to the West and North: x and y are negative
    assert (sight[1:] < 0.0).all()
    for axis in range(3):
        angles = np.eye(3)[axis] * 1e-3
        turn = body_from_nadir(angles).T
        vector = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        assert vector @ sight[[1, 2, 0]] == pytest.approx(math.radians(1e-3) * sight[axis], rel=1e-4)


def test_polarimeters_that_are_not_used_and_none_give_no_model():
    assert used_polarimeters(None) == used_polarimeters(CRAFT) == polarimeter_models(CRAFT, ()) == ()
    two = replace(CRAFT, polarimeters=(replace(STATED, used=False), replace(STATED, source="q", white_deg=0.2)))
    (read,) = polarimeter_models(two, used_polarimeters(two))
    assert read.white_deg == 0.2
    assert used_polarimeters(two, frozenset({"q"})) == ()


def test_a_block_is_the_median_of_the_records_since_the_last_and_due_each_five_minutes():
    rows = records((1, 0.1), (2, 0.2), (3, 5.0), (4, 0.3), (5, 0.2), (6, 0.9))
    block = due_block(rows, STATED, 0, 5 * MINUTE_US)
    assert (block.epoch_us, block.co_power_dbm) == (5 * MINUTE_US, -55.0)
    assert block.angle_deg == pytest.approx(0.2)
    assert block.variance_deg2 == pytest.approx(0.5 * math.pi * 0.07**2 / 5)
    assert due_block(rows, STATED, 2 * MINUTE_US, 6 * MINUTE_US) is None


def test_records_that_are_late_or_stand_still_make_no_block():
    rows = records((1, 0.1), (2, 0.2))
    assert due_block(rows, STATED, -(1 << 62), 18 * MINUTE_US) is None
    assert due_block(records((1, 0.1), (2, 0.1)), STATED, -(1 << 62), 2 * MINUTE_US) is None
    # half an hour and no longer
    assert [row.epoch_us // MINUTE_US for row in records((1, 0.1), (40, 0.1), (12, 0.1))] == [12, 40]


def test_an_angle_serves_as_a_ratio_does_and_a_known_content_is_taken_off():
    stated = replace(STATED, field_t=4e-5)
    row = PolarizationRecord("p", 0, angle_deg=0.4, sigma_deg=0.1, tec_tecu=30.0)
    block = due_block((row,), stated, -(1 << 62), 0)
    assert block.angle_deg == pytest.approx(0.4 - faraday_deg(30.0, 4e-5, 11e9))
    assert block.variance_deg2 == pytest.approx(0.5 * math.pi * 0.01)
    assert math.isnan(block.co_power_dbm)


def test_a_record_states_its_own_feed_and_noise():
    row = PolarizationRecord("p", 0, ratio_db(-5.0, 0.3), feed_offset_deg=-5.0, noise_db=0.175)
    block = due_block((row,), STATED, -(1 << 62), 0)
    assert block.angle_deg == pytest.approx(0.3)
    # by the slope where the ratio stands
    assert block.variance_deg2 == pytest.approx(0.5 * math.pi * (0.175 / slope_db_deg(4.7)) ** 2)
    for steepest_db in (-300.0, 300.0):
        told = due_block((replace(row, ratio_db=steepest_db),), STATED, -(1 << 62), 0)
        assert told.variance_deg2 == pytest.approx(0.5 * math.pi * (0.175 / slope_db_deg(0.5)) ** 2)


def test_what_a_calibration_told_of_a_feed_counts_from_the_catalogue_and_ages():
    told = FeedFit(
        (10.6, 0.02, -0.01), ((4e-4, 1e-5, 0.0), (1e-5, 1e-4, 0.0), (0.0, 0.0, 1e-4)), 0.1, 0.7, 3_600_000_000
    )
    check = PolarimeterCheck("p", MotionVerdict.CONSISTENT, "", 1.0, 0.02, told)
    request = CalibrationRequest(Window(0, 1), Window(0, 1), CalibrationMethod.GEOMETRY)
    result = CalibrationResult((), None, {}, (), polarimeters=(check,))
    made = Calibration(1, 1, 1, CalibrationState.ACTIVE, request, 0, "test", result)
    stated = replace(STATED, daily_deg=0.04, offset_walk_deg_sqrt_h=0.01)
    read = [polarimeter_models(CRAFT, (stated,), made, (1 + hours) * 3_600_000_000)[0] for hours in (0, 9, 10_000)]
    fresh, later, last = (np.array(one.learned.covariance) for one in read if one.learned is not None)
    assert all(one.learned is not None and one.learned.mean == pytest.approx((0.6, 0.02, -0.01)) for one in read)
    assert fresh == pytest.approx(np.array(told.covariance) + np.diag([0.0, 4e-4, 4e-4]))
    assert (later - fresh)[0, 0] == pytest.approx(9e-4)
    assert last[1, 1] == pytest.approx(1e-4 + 1.25 * 0.04**2)
    assert polarimeter_models(CRAFT, (replace(stated, source="q"),), made)[0].learned is None


def test_blocks_follow_one_another_without_a_record_twice():
    rows = [PolarizationRecord("p", minute * MINUTE_US, ratio_db(10.0, 0.1 + 0.01 * minute)) for minute in range(22)]
    found = every_block(rows, STATED)
    assert [one.epoch_us // MINUTE_US for one in found] == [5, 10, 15, 20]
    assert found[1].angle_deg == pytest.approx(0.18)
    assert every_block([], STATED) == []


HOUR_US = 3_600_000_000


def reports(*rows):
    """Return the reports of rows (source, station, hour, attenuation)."""
    kept = {}
    for source, station, hour, attenuation_db in rows:
        kept = with_report(kept, WeatherReport(source, station, round(hour * HOUR_US), None, attenuation_db))
    return kept


def verdicts(kept, hour, *stations):
    return reported_wet(kept, stations, round(hour * HOUR_US)).tolist()


def test_a_station_is_wet_dry_or_nobody_says():
    kept = reports(("radar", "Kyiv", 1.0, 2.0), ("radar", "Minsk", 1.0, 0.0))
    np.testing.assert_array_equal(verdicts(kept, 1.1, "Minsk", "Kyiv", "Omsk", ""), [0.0, 1.0, np.nan, np.nan])


@pytest.mark.parametrize(("rate_mm_h", "is_rain"), [(0.0, 0.0), (0.4, 0.0), (0.5, 1.0), (40.0, 1.0)])
def test_a_rain_rate_serves_as_an_attenuation_does(rate_mm_h, is_rain):
    kept = with_report({}, WeatherReport("gauge", "Kyiv", 0, rate_mm_h))
    assert verdicts(kept, 0.0, "Kyiv") == [is_rain]


def test_a_report_holds_for_half_an_hour_and_rain_for_two_hours():
    dry, rain = reports(("radar", "Kyiv", 0.0, 0.0)), reports(("radar", "Kyiv", 0.0, 1.0))
    np.testing.assert_array_equal([verdicts(dry, h, "Kyiv")[0] for h in (0.5, 0.51)], [0.0, np.nan])
    np.testing.assert_array_equal([verdicts(rain, h, "Kyiv")[0] for h in (2.0, 2.01)], [1.0, np.nan])


def test_an_antenna_dries_after_the_rain():
    kept = reports(*(("radar", "Kyiv", h / 4, 1.0 if h < 4 else 0.0) for h in range(16)))
    assert [verdicts(kept, h, "Kyiv")[0] for h in (0.9, 2.0, 2.7, 3.0)] == [1.0, 1.0, 1.0, 0.0]


def test_what_is_reported_of_later_says_nothing_of_now():
    kept = reports(("radar", "Kyiv", 0.0, 0.0), ("radar", "Kyiv", 3.0, 5.0))
    assert verdicts(kept, 0.2, "Kyiv") == [0.0]
    assert np.isnan(verdicts(kept, -0.1, "Kyiv")).all()


def test_reports_may_come_in_any_order_and_the_source_that_sees_rain_is_believed():
    rows = [("radar", "Kyiv", 1.0, 1.0), ("radar", "Kyiv", 0.5, 0.0), ("gauge", "Kyiv", 1.0, 0.0)]
    assert verdicts(reports(*rows), 1.0, "Kyiv") == verdicts(reports(*rows[::-1]), 1.0, "Kyiv") == [1.0]
    assert verdicts(reports(*rows), 0.6, "Kyiv") == [0.0]


def test_hours_and_a_number_of_reports_are_kept():
    often = reports(*(("radar", "Kyiv", k / 3600, 0.0) for k in range(1000)))
    assert len(often["Kyiv"]["radar"].epochs_us) == 400
    long = reports(*(("radar", "Kyiv", k / 2, 1.0) for k in range(30)))
    assert len(long["Kyiv"]["radar"].epochs_us) == len(long["Kyiv"]["radar"].rain_us) == 13
