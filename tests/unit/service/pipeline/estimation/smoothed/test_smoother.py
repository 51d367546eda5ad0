"""Smoothed rows in the pipeline."""

from collections import deque
from dataclasses import replace

import filter_models
import numpy as np
import pytest
from geometry_flight import MINUTE
from stepped_robust import ALIGNED_US, CONFIG, PAYLOAD, Stepped

from service.core.estimation.filtering.filter_model import ATTITUDE, DRIFT, RATE
from service.pipeline.estimation import smoothed as lagged_rows
from service.pipeline.estimation import smoothed as smoother
from service.pipeline.estimation.robust.row_recorder import RowRecorder
from service.pipeline.estimation.robust.runner import steps_in_time
from service.pipeline.estimation.smoothed import GRID_US, LaggedRows, SpanSmoother, angles_of, grid_us, lagged_angles
from service.records.catalogue import BodyRateSensor, Method, Polarimeter, WheelMomentum
from service.records.inputs import PolarizationRecord, TelemetryRecord
from service.records.levels.attitude import Axes, row_without_attitude

#: a row each ten minutes for thirty hours
ROW_US, ROWS, CARRIERS = 600_000_000, 180, 6
HOUR_US = 3_600_000_000


class Kept:
    """Recorder of rows that are handed to it."""

    def __init__(self):
        self.rows = deque()

    def drop(self, count):
        for _ in range(count):
            self.rows.popleft()


@pytest.fixture(scope="module")
def rows():
    return filter_models.quiet_effective_rows(ROWS, CARRIERS, ROW_US, seed=3)


def left_by(recorder, rows):
    """Return what leaves a smoother with each row, and at the end."""
    span, left = SpanSmoother(recorder), []
    for row in rows:
        recorder.rows.append(row)
        left.append(span.pop())
    return [*left, span.rest()]


def test_every_row_leaves_once_and_in_order(rows):
    left = [each for block in left_by(Kept(), rows) for each in block]
    assert [each.epoch_us for each in left] == [row.epoch_us for row in rows]


def test_a_block_knows_half_a_day_and_is_nearly_the_whole_span(rows):
    recorder = Kept()
    left = left_by(recorder, rows)
    blocks = [block for block in left if block]
    assert [len(block) for block in blocks] == [36, 36, 108]
    assert min(each.lag_us for block in blocks[:-1] for each in block) >= smoother.REACH_H * HOUR_US
    assert blocks[-1][-1].lag_us == 0
    whole = angles_of(rows, ROWS)
    for own, best in zip([each for block in blocks for each in block], whole, strict=True):
        sigma = np.sqrt(np.diag(own.state.covariance))[ATTITUDE]
        best_sigma = np.sqrt(np.diag(best.state.covariance))[ATTITUDE]
        # half a day leaves less than a hundredth of the sigma
        np.testing.assert_allclose(sigma, best_sigma, rtol=0.01)
        assert (np.abs(own.state.mean - best.state.mean)[ATTITUDE] < 0.2 * best_sigma).all()


def test_rows_that_come_fast_leave_before_they_fill_the_memory(rows, monkeypatch):
    monkeypatch.setattr(smoother, "MOST_ROWS", 30)
    recorder, most = Kept(), 0
    span, left = SpanSmoother(recorder), []
    for row in rows:
        recorder.rows.append(row)
        most = max(most, len(recorder.rows))
        left += span.pop()
    assert most == 30
    left += span.rest()
    assert [each.epoch_us for each in left] == [row.epoch_us for row in rows]


def test_a_row_that_left_and_is_taken_again_does_not_leave_again(rows):
    recorder = Kept()
    span, left = SpanSmoother(recorder), []
    for row in [*rows[:120], *rows[30:]]:
        while recorder.rows and recorder.rows[-1].epoch_us >= row.epoch_us:
            recorder.rows.pop()
        recorder.rows.append(row)
        left += span.pop()
    left += span.rest()
    epochs = [each.epoch_us for each in left]
    assert epochs == sorted(set(epochs))


def test_a_fixed_lag_knows_exactly_the_rows_of_that_time(rows):
    found = lagged_angles(rows, 2 * HOUR_US)
    assert (found.epoch_us, found.lag_us) == (rows[-13].epoch_us, 2 * HOUR_US)
    best = angles_of(rows, ROWS)[-13]
    np.testing.assert_allclose(found.state.mean, best.state.mean, rtol=1e-12)
    assert lagged_angles(rows[:12], 2 * HOUR_US) is None
    assert lagged_angles([], HOUR_US) is None


#: a row each minute for three hours
MINUTE_ROW_US = 60_000_000


@pytest.fixture(scope="module")
def effective():
    """Effective rows of a quiet filter, by epoch."""
    return filter_models.quiet_effective_rows(ROWS, CARRIERS, MINUTE_ROW_US, seed=7)


def robust(epoch_us, *inhibitions):
    return row_without_attitude(epoch_us, epoch_us, epoch_us // MINUTE_ROW_US, Method.ROBUST, inhibitions)


def made_of(lagged, effective):
    """Return what is made with each row."""
    made = []
    for each in effective:
        lagged.recorder._rows.append(each)
        made.append(lagged.push(each.epoch_us, [robust(each.epoch_us)]))
    return made


def test_the_grid_is_that_of_the_clock():
    assert [grid_us(epoch_us) for epoch_us in (0, GRID_US - 1, GRID_US, GRID_US + 1)] == [0, 0, GRID_US, GRID_US]


def test_each_instant_has_its_row_as_soon_as_the_lag_has_passed(effective):
    lagged = LaggedRows(HOUR_US, 0)
    made = made_of(lagged, effective)
    # rows stand on the instants: that of 5 min is due with that of 65 min
    assert [k + 1 for k, rows in enumerate(made) if rows] == list(range(65, ROWS + 1, 5))
    for k, rows in enumerate(made):
        for row in rows:
            expected = lagged_angles(effective[: k + 1], HOUR_US)
            assert (row.epoch_us, row.lag_s) == (expected.epoch_us, 3600.0)
            assert list(row.attitude_deg) == expected.state.mean[:3].tolist()
    assert lagged.made_us == grid_us(effective[-1].epoch_us - HOUR_US)


def test_memory_holds_no_row_that_no_instant_needs(effective):
    lagged = LaggedRows(HOUR_US, 0)
    made_of(lagged, effective)
    assert len(lagged.recorder.rows) <= 61 + 5


def test_rows_behind_the_filter_and_those_of_other_methods_are_none(effective):
    lagged = LaggedRows(HOUR_US, 0)
    for each in effective[:70]:
        lagged.recorder._rows.append(each)
        late = robust(each.epoch_us, "late")
        other = row_without_attitude(each.epoch_us, each.epoch_us, 1, Method.PAPER, ())
        assert lagged.push(each.epoch_us, [late, other]) == []
    # the instants are passed all the same
    assert lagged.made_us == GRID_US * 2


def test_an_instant_without_rows_has_none_and_what_came_before_a_gap_knows_what_came_after(effective):
    lagged = LaggedRows(HOUR_US, 0)
    rest = [each for each in effective if not 40 * MINUTE_ROW_US < each.epoch_us < 150 * MINUTE_ROW_US]
    made = [row for rows in made_of(lagged, rest) for row in rows]
    instants = [-(-row.epoch_us // GRID_US) for row in made]
    assert instants == [1, 2, 3, 4, 5, 6, 7, 8]
    assert {row.lag_s for row in made} == {150 * 60.0 - 300.0 * k for k in instants}


def test_where_too_many_rows_lie_beyond_a_shorter_lag_must_do(effective, monkeypatch):
    monkeypatch.setattr(lagged_rows, "MOST_LATER", 20)
    lagged = LaggedRows(HOUR_US, 0)
    made = [row for rows in made_of(lagged, effective) for row in rows]
    assert {row.lag_s for row in made} == {20 * 60.0}
    assert len(made) == (ROWS - 20) // 5


SENSED_ROWS, JOINED, LAG_MIN = 40, 8, 20
#: of a body that turns with the orbit, deg/s
STILL = Axes(yaw=0.0, roll=0.0, pitch=-15.0411 / 3600.0)
SENSOR = BodyRateSensor(in_loop=False, bias_deg_h=0.01, bias_tau_h=8.0, noise_deg_sqrt_h=0.003)


@pytest.fixture(scope="module")
def recorded():
    """Return recorders from the first row on, and from a later one, with the filter's sigma (3,) of each row."""
    rng, craft = np.random.default_rng(20261126), PAYLOAD.spacecraft()
    onboard = replace(craft.onboard, momentum=WheelMomentum(), rate_sensor=SENSOR)
    flight = Stepped(spacecraft=replace(craft, onboard=onboard, polarimeters=(Polarimeter("p", 10.0, 11e9),)))
    whole, joined, state, sigma_deg, angles, rates = (
        RowRecorder(SENSED_ROWS),
        RowRecorder(SENSED_ROWS),
        flight.state,
        [],
        [],
        [],
    )
    for minute in range(1, SENSED_ROWS + 1):
        at_us = ALIGNED_US + minute * MINUTE
        wheels = tuple((np.array([0.2, -8.0, 0.1]) + rng.normal(0.0, 0.01, 3)).tolist())
        telemetry = TelemetryRecord(at_us - MINUTE, wheel_momentum_n_m_s=wheels, thrusters_active=minute == 25)
        angles.append(PolarizationRecord("p", at_us, angle_deg=1.0 + rng.normal(0.0, 0.05), sigma_deg=0.05))
        noise = rng.normal(0.0, 1e-6, 3)
        rates.append(TelemetryRecord(at_us, body_rate_deg_s=Axes(*(np.array([*STILL]) + noise).tolist())))
        heard = flight.knowledge._replace(momenta=(telemetry,), polarization={"p": tuple(angles)}, rates=tuple(rates))
        measurement = PAYLOAD.measurement(at_us, np.zeros(3))
        power_dbm = measurement.power_dbm + rng.normal(0.0, 0.05, len(measurement.power_dbm))
        for recorder in (whole, joined) if minute >= JOINED else (whole,):
            (outcome,) = steps_in_time(
                state,
                model=flight.model,
                knowledge=heard,
                measurements=[measurement],
                power_dbm=power_dbm[None, :],
                is_catch_up=False,
                config=CONFIG,
                recorder=recorder,
            )
        state = outcome.state
        sigma_deg.append(state.filter.gaussian.attitude_sigma_deg)
    assert not state.filter.sensors["is_refused"].any()
    assert state.filter.rates["is_measured"][0]
    assert (state.filter.sensors["records"] > 0.0).all()
    return whole.rows, joined.rows, np.array(sigma_deg)


def test_records_leave_no_gap_in_the_past_and_are_all_kept(recorded):
    whole, joined, _ = recorded
    assert [row.origin is None for row in whole] == [True] + [False] * (SENSED_ROWS - 1)
    assert [row.origin is None for row in joined] == [True] + [False] * (SENSED_ROWS - JOINED)
    taken = [len(record.update.residual) for row in whole for record in row.sensed if record.update is not None]
    assert taken.count(3) == SENSED_ROWS
    assert taken.count(1) > SENSED_ROWS // 6
    # a measured rate takes the place of the rate before it
    moving = set(range(DRIFT.start, RATE.stop))
    assert all(set(row.sensed[-1].restarted.tolist()) <= moving for row in whole)
    assert all(set(range(RATE.start, RATE.stop)) <= set(row.sensed[-1].restarted.tolist()) for row in whole)


def test_smoothed_sigma_is_below_the_filters(recorded):
    whole, _, sigma_deg = recorded
    smoothed = [np.sqrt(np.diag(each.state.covariance)[ATTITUDE]) for each in angles_of(list(whole), SENSED_ROWS)]
    assert (smoothed[:-1] < sigma_deg[:-1]).all()


def test_a_fixed_lag_gives_the_rows_of_the_whole_span_that_ends_with_it(recorded):
    whole, joined, _ = recorded
    for newest in range(JOINED + LAG_MIN, SENSED_ROWS + 1):
        found = lagged_angles(list(joined)[: newest - JOINED + 1], LAG_MIN * MINUTE)
        expected = angles_of(list(whole)[:newest], newest)[newest - LAG_MIN - 1]
        np.testing.assert_array_equal(found.state.mean, expected.state.mean)
        np.testing.assert_array_equal(found.state.covariance, expected.state.covariance)
