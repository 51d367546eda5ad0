"""Polarimeters of the catalogue and blocks of their records."""

import math
from dataclasses import replace

import numpy as np
import pytest

from service.core.estimation.filtering.model.polarimeter import faraday_deg, ratio_db, slope_db_deg
from service.core.geometry.frames import body_from_nadir
from service.pipeline.inputs.polarization import (
    due_block,
    every_block,
    line_of_sight,
    polarimeter_models,
    used_polarimeters,
    with_polarization_record,
)
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
from service.records.catalogue import Polarimeter, Site, Spacecraft
from service.records.inputs import PolarizationRecord

MINUTE_US = 60_000_000
STATED = Polarimeter("p", 10.0, 11e9)
CRAFT = Spacecraft("y", "Y", 49.0, Site(55.9, 38.0), np.diag([2600.0, 1400.0, 2600.0]).tolist(), 0.05)


def records(*rows: tuple[float, float]) -> tuple[PolarizationRecord, ...]:
    """Return records of rows (minute, angle), angles as ratios."""
    kept: dict[str, tuple[PolarizationRecord, ...]] = {}
    for minute, angle_deg in rows:
        ratio = ratio_db(10.0, angle_deg)
        kept = with_polarization_record(kept, PolarizationRecord("p", round(minute * MINUTE_US), ratio, -55.0))
    return kept["p"]


def test_the_line_of_sight_is_that_of_a_turned_body() -> None:
    sight = np.array(line_of_sight(CRAFT, STATED))
    assert np.linalg.norm(sight) == pytest.approx(1.0)
    # the station stands to the West and North: x and y are negative
    assert (sight[1:] < 0.0).all()
    for axis in range(3):
        angles = np.eye(3)[axis] * 1e-3
        turn = body_from_nadir(angles).T
        vector = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        assert vector @ sight[[1, 2, 0]] == pytest.approx(math.radians(1e-3) * sight[axis], rel=1e-4)


def test_polarimeters_that_are_not_used_and_none_give_no_model() -> None:
    assert used_polarimeters(None) == used_polarimeters(CRAFT) == polarimeter_models(CRAFT, ()) == ()
    two = replace(CRAFT, polarimeters=(replace(STATED, used=False), replace(STATED, source="q", white_deg=0.2)))
    (read,) = polarimeter_models(two, used_polarimeters(two))
    assert read.white_deg == 0.2
    assert used_polarimeters(two, frozenset({"q"})) == ()


def test_a_block_is_the_median_of_the_records_since_the_last_and_due_each_five_minutes() -> None:
    rows = records((1, 0.1), (2, 0.2), (3, 5.0), (4, 0.3), (5, 0.2), (6, 0.9))
    block = due_block(rows, STATED, 0, 5 * MINUTE_US)
    assert block is not None
    assert (block.epoch_us, block.co_power_dbm) == (5 * MINUTE_US, -55.0)
    assert block.angle_deg == pytest.approx(0.2)
    assert block.variance_deg2 == pytest.approx(0.5 * math.pi * 0.07**2 / 5)
    assert due_block(rows, STATED, 2 * MINUTE_US, 6 * MINUTE_US) is None


def test_records_that_are_late_or_stand_still_make_no_block() -> None:
    rows = records((1, 0.1), (2, 0.2))
    assert due_block(rows, STATED, -(1 << 62), 18 * MINUTE_US) is None
    assert due_block(records((1, 0.1), (2, 0.1)), STATED, -(1 << 62), 2 * MINUTE_US) is None
    # half an hour and no longer
    assert [row.epoch_us // MINUTE_US for row in records((1, 0.1), (40, 0.1), (12, 0.1))] == [12, 40]


def test_an_angle_serves_as_a_ratio_does_and_a_known_content_is_taken_off() -> None:
    stated = replace(STATED, field_t=4e-5)
    row = PolarizationRecord("p", 0, angle_deg=0.4, sigma_deg=0.1, tec_tecu=30.0)
    block = due_block((row,), stated, -(1 << 62), 0)
    assert block is not None
    assert block.angle_deg == pytest.approx(0.4 - faraday_deg(30.0, 4e-5, 11e9))
    assert block.variance_deg2 == pytest.approx(0.5 * math.pi * 0.01)
    assert math.isnan(block.co_power_dbm)


def test_a_record_states_its_own_feed_and_noise() -> None:
    row = PolarizationRecord("p", 0, ratio_db(-5.0, 0.3), feed_offset_deg=-5.0, noise_db=0.175)
    block = due_block((row,), STATED, -(1 << 62), 0)
    assert block is not None
    assert block.angle_deg == pytest.approx(0.3)
    # by the slope where the ratio stands
    assert block.variance_deg2 == pytest.approx(0.5 * math.pi * (0.175 / slope_db_deg(4.7)) ** 2)
    for steepest_db in (-300.0, 300.0):
        told = due_block((replace(row, ratio_db=steepest_db),), STATED, -(1 << 62), 0)
        assert told is not None
        assert told.variance_deg2 == pytest.approx(0.5 * math.pi * (0.175 / slope_db_deg(0.5)) ** 2)


def test_what_a_calibration_told_of_a_feed_counts_from_the_catalogue_and_ages() -> None:
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


def test_blocks_follow_one_another_without_a_record_twice() -> None:
    rows = [PolarizationRecord("p", minute * MINUTE_US, ratio_db(10.0, 0.1 + 0.01 * minute)) for minute in range(22)]
    found = every_block(rows, STATED)
    assert [one.epoch_us // MINUTE_US for one in found] == [5, 10, 15, 20]
    assert found[1].angle_deg == pytest.approx(0.18)
    assert every_block([], STATED) == []
