"""Beams over the interface: a moved antenna is told, and what is missing is said."""

import numpy as np
import pytest
from geometry_flight import FlightPayload

from service.core.estimation.calibration.geometry_columns import predict_deviation
from service.pipeline.carrier_model.expected_level import geometry_model
from service.ports.archive import Outcome
from service.records.calibration import CalibrationMethod, CalibrationRequest, Window
from service.records.catalogue import Method
from service.records.epoch import format_epoch
from service.records.inputs import AttitudeReference
from service.records.levels.attitude import Axes, CarrierResults

pytestmark = pytest.mark.anyio
SEED = 5
HOUR_US, DAY_US = 3_600_000_000, 86_400_000_000
HOURS, STEP_US = 60, 600_000_000
NORTH_DEG = 0.05


@pytest.fixture
def payload(bench, make):
    """Sixty hours of rows each ten minutes, aligned; the antenna moves once a day and a star tracker works."""
    rng = np.random.default_rng(SEED)
    print("seed", SEED)
    result = FlightPayload.make(16).calibration().result
    plan = bench.storage.catalogue.put_plan(make.sc, FlightPayload.make(16).plan(1).carriers, "beams")
    start_us = (make.now_us // DAY_US - 3) * DAY_US
    calibrate(bench, make, plan.id, result, start_us - 5 * DAY_US)
    alignment = bench.align(start_us - HOUR_US)
    epochs_us = start_us + STEP_US * np.arange(HOURS * 6)
    angles = rng.normal(0.0, 0.01, (len(epochs_us), 3))
    angles[18:24] += [0.0, 0.3, 0.0] * (np.arange(6) > 2)[:, None]  # a turn of roll at half past three
    model = geometry_model(result.geometry, result.carriers)
    north = NORTH_DEG * np.cos(2 * np.pi * (epochs_us % DAY_US) / DAY_US)
    deviation = predict_deviation(angles, model.response) - np.outer(north, np.array(result.geometry.gradient)[:, 1])
    deviation += rng.normal(0.0, 0.02, deviation.shape)
    rows = bench.append(epochs_us.tolist(), np.array(result.geometry.level_dbm) + deviation, plan_id=plan.id)
    codes = np.zeros(16, dtype=np.int64)
    outcomes = [
        Outcome(
            (make.row(row, method=Method.ROBUST, alignment_id=alignment.id),),
            None,
            carriers=(CarrierResults(plan.id, levels_db, levels_db, codes, codes),),
        )
        for row, levels_db in zip(rows, deviation, strict=True)
    ]
    bench.consume(outcomes)
    readings = [
        AttitudeReference("star_tracker", int(at), Axes(*angle), Axes(0.01, 0.01, 0.01))
        for at, angle in zip(epochs_us, angles, strict=True)
    ]
    bench.storage.archive.append_inputs(make.sc, readings)
    return {"start": format_epoch(start_us), "stop": format_epoch(start_us + HOURS * HOUR_US)}


def calibrate(bench, make, plan_id, result, turns_us):
    """Store and activate a calibration by geometry whose turns were flown at an epoch."""
    quiet, turns = Window(turns_us - 3 * DAY_US, turns_us), Window(turns_us, turns_us + DAY_US)
    request = CalibrationRequest(quiet, turns, CalibrationMethod.GEOMETRY)
    draft = bench.storage.results.add_calibration(make.sc, request, plan_id, 1, make.now_us, "engineer")
    bench.storage.results.finish_calibration(make.sc, draft.id, result, None)
    return bench.storage.results.activate_calibration(make.sc, draft.id)


async def test_a_moved_antenna_is_told_by_the_hour(bench, payload):
    reported = await bench.get("/beams", **payload)
    (antenna,) = reported["antennas"]
    assert reported["sensors"] == ["star_tracker"]
    assert (len(reported["epochs"]), reported["day_step"], reported["group"]) == (HOURS, 1, "band")
    assert [k for k, is_turned in enumerate(reported["turned"]) if is_turned] == [3]
    assert antenna["north_deg"][3] is None
    assert antenna["cause"] == "antenna_or_sensor"
    assert antenna["north"]["daily"]["amplitude_deg"] == pytest.approx(NORTH_DEG, abs=0.008)
    assert min(antenna["north"]["daily"]["peak_h"], 24 - antenna["north"]["daily"]["peak_h"]) < 1.0
    assert antenna["east"]["daily"]["amplitude_deg"] < 0.01
    assert any("cannot be told from an error of the sensor" in note for note in reported["notes"])
    assert len(reported["stations"]) == 16
    assert reported["compared_calibration_id"] is None
    # an open span is the last seven days of rows
    open_span = await bench.get("/beams")
    assert open_span["epochs"] == reported["epochs"]
    assert any("begins with the first alignment" in note for note in open_span["notes"])


async def test_another_campaign_is_compared(bench, make, payload):
    first = bench.storage.results.calibrations(make.sc)[0]
    again = calibrate(bench, make, first.plan_id, first.result, first.request.turns.stop_us + DAY_US)
    reported = await bench.get("/beams", **payload)
    assert (reported["calibration_id"], reported["compared_calibration_id"]) == (again.id, first.id)
    assert {one["change_sigmas"] for one in reported["stations"]} == {0.0}
    # nothing was aligned by the new calibration yet: what it would have expected of those rows is not stored
    assert reported["epochs"] == []
    assert reported["notes"] == ["no alignment before the end of the span uses this calibration: no boresight"]


async def test_without_rows_it_says_so(bench, make, payload):
    later = {"start": payload["stop"], "stop": format_epoch(make.now_us)}
    reported = await bench.get("/beams", **later)
    assert reported["epochs"] == []
    assert any("no hour has both powers and readings" in note for note in reported["notes"])


async def test_what_cannot_be_asked(bench, make):
    path = f"/spacecraft/{make.sc}/beams"
    assert (await bench.refused("GET", path))[:2] == (409, "beams.no_calibration")
    assert (await bench.refused("GET", path, params={"group": "user"}))[0] == 422
    assert (await bench.refused("GET", "/spacecraft/none/beams"))[0] == 404


async def test_a_long_span_is_refused_before_anything_is_read(bench, payload):
    path = f"{bench.url.removeprefix('/api/v1')}/beams"
    params = {"start": "2020-01-01T00:00:00Z", "stop": payload["stop"]}
    assert await bench.refused("GET", path, params=params) == (422, "range.too_long", [])
