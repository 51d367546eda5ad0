"""Rows closer than twenty seconds are means of a minute, others stay to the bit, however they are handed over."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_payload import MINUTE, GeometryPayload, S
from hypothesis import given
from hypothesis import strategies as st

from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.calibration.minute_rows import mean_edges_us, minute_rows
from service.pipeline.config import CalibrationConfig
from service.records.calibration import CalibrationMethod, CalibrationRequest, Window
from service.records.inputs import Operation
from service.records.levels.series import MeasurementSeries

NAMES = ("a", "b")


def series(epochs_us, power_dbm=None):
    epochs_us = np.asarray(epochs_us, dtype=np.int64)
    if power_dbm is None:
        power_dbm = np.random.default_rng(1).normal(-45.0, 0.1, (len(epochs_us), len(NAMES)))
    return MeasurementSeries(NAMES, epochs_us, power_dbm)


def parts_of(whole, cuts):
    stops = [*sorted(min(cut, len(whole.epochs_us)) for cut in cuts), len(whole.epochs_us)]
    for start, stop in zip([0, *stops[:-1]], stops, strict=True):
        yield MeasurementSeries(NAMES, whole.epochs_us[start:stop], whole.power_dbm[start:stop])


def equal(one, other):
    arrays = ((found.series.epochs_us, found.series.power_dbm, found.measurements) for found in (one, other))
    for first, second in zip(*arrays, strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("period_s", [20, 60, 300])
def test_rows_that_are_no_closer_than_twenty_seconds_stay_to_the_bit(period_s):
    rows = series(np.arange(3000) * period_s * S)
    rows.power_dbm[5, 1] = np.nan
    found = minute_rows([rows], NAMES, [7 * MINUTE])
    np.testing.assert_array_equal(found.series.power_dbm, rows.power_dbm)
    np.testing.assert_array_equal(found.series.epochs_us, rows.epochs_us)
    assert (found.measurements == 1).all()
    assert found.usual_measurements == 1.0


def test_close_rows_become_means_of_a_minute_without_impulses():
    rows = series(np.arange(3600) * S)
    expected = rows.power_dbm.reshape(60, 60, 2).mean(axis=1)
    kept = np.delete(rows.power_dbm[:60, 0], 7).mean()
    rows.power_dbm[7, 0] += 6.0
    rows.power_dbm[60:120, 1] = np.nan
    found = minute_rows([rows], NAMES, ())
    assert found.series.epochs_us.tolist() == [MINUTE * k + 29_500_000 for k in range(60)]
    assert found.series.power_dbm[0, 0] == pytest.approx(kept, abs=1e-12)
    assert np.isnan(found.series.power_dbm[1, 1])
    np.testing.assert_allclose(found.series.power_dbm[2:], expected[2:], atol=1e-12)
    np.testing.assert_array_equal(found.first_dbm, rows.power_dbm[::60])
    assert found.usual_measurements == 60.0


def test_no_mean_reaches_across_a_window_or_an_operation():
    quiet, turns = Window(0, 90 * S), Window(90 * S, 300 * S)
    request = CalibrationRequest(quiet, turns, CalibrationMethod.GEOMETRY)
    operation = Operation(1, "eclipse", 130 * S, 200 * S)
    edges_us = mean_edges_us(request, [operation])
    rows = series(np.arange(300) * S)
    found = minute_rows([rows], NAMES, edges_us)
    assert found.measurements.tolist() == [60, 30, 30, 10, 50, 20, 40, 60]
    # rows that belong to both windows have one epoch
    twice = minute_rows([series(np.arange(60, 300) * S)], NAMES, edges_us)
    assert set(twice.series.epochs_us.tolist()) <= set(found.series.epochs_us.tolist())


@given(st.lists(st.integers(0, 5000), max_size=6), st.sampled_from([1, 5, 13, 19, 20, 60]), st.integers(0, 59_999_999))
def test_where_parts_end_does_not_change_the_rows(cuts, period_s, begin_us):
    rows = series(begin_us + np.arange(5000) * period_s * S)
    equal(minute_rows(parts_of(rows, cuts), NAMES, ()), minute_rows([rows], NAMES, ()))


def test_a_change_of_the_row_period_keeps_every_measurement():
    epochs_us = np.concatenate([np.arange(2000) * MINUTE, 2000 * MINUTE + np.arange(7200) * S])
    found = minute_rows([series(epochs_us)], NAMES, ())
    assert found.measurements.sum() == len(epochs_us)
    assert (np.diff(found.series.epochs_us) > 0).all()
    assert len(found.series.epochs_us) < 2000 + 1200


def test_nothing_has_its_columns():
    found = minute_rows([], NAMES, ())
    assert found.series.power_dbm.shape == found.first_dbm.shape == (0, 2)
    assert found.usual_measurements == 1.0


def test_a_calibration_by_means_tells_the_noise_of_a_measurement_and_the_steps_of_the_analyzer():
    data = GeometryPayload.make(8, quiet_days=2.0).data(noise_db=0.02)
    stepped_dbm = np.round(data.quiet.power_dbm / 0.1) * 0.1
    of_means = replace(data, row_measurements=9.0, quiet_first_dbm=stepped_dbm)
    plain, means = (calibrate_geometry(each, CalibrationConfig()) for each in (data, of_means))
    white_db = np.array([[carrier.sigma_white_db for carrier in result.carriers] for result in (plain, means)])
    np.testing.assert_allclose(white_db[1], 3.0 * white_db[0], rtol=1e-12)
    assert plain.quality["quantisation_db"] == 0.0
    assert means.quality["quantisation_db"] == pytest.approx(0.1, rel=0.02)
