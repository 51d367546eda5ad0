"""Records of the robust method: rows, rates, momentum, polarisation and frozen readings."""

from dataclasses import replace
from types import SimpleNamespace

import filter_models
import numpy as np
import pytest
from filter_rows import after_records, step
from geometry_flight import MINUTE
from stepped_robust import ALIGNED_US, PAYLOAD, Stepped

from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    RATE,
    FilterSettings,
    core_size,
    hidden_count,
    no_motion,
)
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.plant import filter_model, sensor_states
from service.core.estimation.filtering.readings import frozen_readings, no_readings
from service.core.estimation.filtering.sensor_records import model_of_step
from service.core.estimation.filtering.state_changes import with_share
from service.pipeline.estimation.robust.method import carried_state
from service.pipeline.estimation.robust.row_recorder import RowRecorder
from service.pipeline.estimation.robust.sensor_records import due_records
from service.records.calibration import GatheredTorque
from service.records.catalogue import BodyRateSensor, Polarimeter, WheelMomentum
from service.records.inputs import PolarizationRecord, TelemetryRecord
from service.records.levels.attitude import Axes

MINUTE_US, CARRIERS = 60_000_000, 6


@pytest.fixture
def model():
    carriers = filter_models.carrier_model(carriers=CARRIERS)
    return SimpleNamespace(
        filter=carriers,
        settings=FilterSettings(),
        arrays=filter_model(carriers),
        rate_sensor=None,
        calibration_id=1,
        carrier_ids=tuple("abcdef"),
    )


def aligned(model):
    return start(model.filter, 0, filter_models.aligned(model.filter))


def run(recorder, model, state, rows, *, is_recorded=True, **known):
    """Take rows that swing and return the state after them."""
    for _ in range(rows):
        level_db = 0.1 * np.sin(state.epoch_us / MINUTE_US + np.arange(CARRIERS))
        motion = no_motion()._replace(**known)
        epoch_us = state.epoch_us + MINUTE_US
        found = step(model.arrays, state, epoch_us, level_db, motion)
        if is_recorded:
            recorder.push(model, state, found.state, found.row, found.trace)
        state = found.state
    return state


def test_a_row_that_is_taken_again_replaces_itself_and_all_later_ones(model):
    recorder = RowRecorder(100)
    third = run(recorder, model, aligned(model), 3)
    run(recorder, model, third, 4)
    again = run(recorder, model, third, 2)
    assert [row.epoch_us // MINUTE_US for row in recorder.rows] == [1, 2, 3, 4, 5]
    assert recorder.rows[-1].mean is again.mean
    np.testing.assert_array_equal(recorder.rows[3].origin, np.arange(len(third.mean)))


def test_the_first_row_and_one_after_a_gap_in_the_record_have_no_past(model):
    recorder = RowRecorder(100)
    state = run(recorder, model, aligned(model), 2)
    state = run(recorder, model, state, 1, is_recorded=False)
    run(recorder, model, state, 1)
    assert [row.origin is None for row in recorder.rows] == [True, False, True]


def test_another_calibration_has_no_past(model):
    recorder = RowRecorder(100)
    state = run(recorder, model, aligned(model), 2)
    other = SimpleNamespace(**{**vars(model), "calibration_id": 2})
    state = state._replace(mean=state.mean.copy())
    run(recorder, other, state, 1)
    assert recorder.rows[-1].origin is None


def test_a_released_command_is_a_new_state_and_all_others_have_their_past(model):
    recorder = RowRecorder(100)
    state = run(recorder, model, aligned(model), 2)
    run(recorder, model, with_share(model.filter, state, 0), 1, unreported=np.zeros((1, 2, 3)))
    origin = recorder.rows[-1].origin
    assert np.flatnonzero(origin < 0).tolist() == [core_size(model.filter)]
    np.testing.assert_array_equal(np.delete(origin, core_size(model.filter)), np.arange(len(state.mean)))


def test_a_row_that_is_not_newer_than_the_state_is_not_kept(model):
    recorder = RowRecorder(100)
    state = run(recorder, model, aligned(model), 2)
    found = step(model.arrays, state, state.epoch_us, np.zeros(CARRIERS), no_motion())
    recorder.push(model, state, found.state, found.row, found.trace)
    assert len(recorder.rows) == 2


def test_memory_is_bounded(model):
    recorder = RowRecorder(5)
    run(recorder, model, aligned(model), 9)
    assert [row.epoch_us // MINUTE_US for row in recorder.rows] == [5, 6, 7, 8, 9]


#: of an Earth-pointing spacecraft, beside some drift; deg/s
RATE_DEG_S = Axes(yaw=1e-5, roll=-5e-6, pitch=-15.0411 / 3600.0 + 2e-6)


def sensed(flight, state=None, knowledge=None):
    """Return the state before a row a minute after the alignment, and the records that were due."""
    state, to_us = state or flight.state, ALIGNED_US + MINUTE
    records = due_records(state.filter, flight.model, knowledge or flight.knowledge, to_us)
    return replace(state, filter=after_records(flight.model.arrays, state.filter, records, to_us)), records


def same_numbers(one, other):
    return np.array_equal(one.mean, other.mean) and np.array_equal(one.covariance, other.covariance)


def stepped(sensor, minutes):
    """Return a model whose sensor has told its rate at some minutes."""
    spacecraft = PAYLOAD.spacecraft()
    onboard = replace(spacecraft.onboard, rate_sensor=sensor)
    rates = tuple(
        TelemetryRecord(ALIGNED_US + round(minute * MINUTE), body_rate_deg_s=RATE_DEG_S) for minute in minutes
    )
    return Stepped(spacecraft=replace(spacecraft, onboard=onboard), rates=rates)


BESIDE = BodyRateSensor(in_loop=False, bias_deg_h=0.01, bias_tau_h=8.0, noise_deg_sqrt_h=0.003)


def advice(flight):
    """Return what the next row advises, records of sensors among it."""
    return list(flight.step(2).row.advice)


def test_a_step_with_a_record_is_moved_by_its_rate_without_the_turn_of_the_orbit():
    flight = stepped(BESIDE, (0.5, 1.0))
    state, _ = sensed(flight)
    assert state.filter.rates["is_measured"][0]
    np.testing.assert_allclose(state.filter.mean[RATE], [0.036, -0.018, 0.0072], atol=1e-3)
    moving = model_of_step(flight.model.arrays, state.filter)
    assert moving.plant["drift_deg_h"].tolist() == [[0.01, 0.01, 0.01]]
    assert advice(flight) == []


def test_records_behind_the_step_later_ones_and_none_leave_it_to_the_inertial_model():
    for minutes in ((), (-11.0,), (2.0,)):
        flight = stepped(BESIDE, minutes)
        state, records = sensed(flight)
        assert not len(records)
        assert not state.filter.rates["is_measured"][0]
        assert model_of_step(flight.model.arrays, state.filter) is flight.model.arrays
        assert same_numbers(state.filter, flight.state.filter)


def test_rates_of_the_loop_are_left_out_with_words():
    flight = stepped(BodyRateSensor(in_loop=True), (0.5, 1.0))
    assert not len(sensed(flight)[1])
    assert advice(flight) == ["rates_in_loop"]


def flight(pitch_n_m_s, bias_n_m_s):
    """Return a filter at its alignment, whose wheels have told a momentum along pitch."""
    spacecraft = PAYLOAD.spacecraft()
    onboard = replace(spacecraft.onboard, momentum=WheelMomentum(pitch_bias_n_m_s=bias_n_m_s))
    axes = np.array(spacecraft.wheels.axes)
    wheels = tuple((np.array([0.3, pitch_n_m_s, -0.2]) @ np.linalg.pinv(axes)).tolist())
    record = TelemetryRecord(ALIGNED_US, wheel_momentum_n_m_s=wheels)
    return Stepped(spacecraft=replace(spacecraft, onboard=onboard), momenta=(record,))


@pytest.mark.parametrize(
    ("pitch_n_m_s", "bias_n_m_s", "is_refused"),
    [
        pytest.param(-8.1, -8.0, False, id="as stated"),
        pytest.param(-4.5, -8.0, False, id="gathered since the unloading"),
        pytest.param(-0.008, -8.0, True, id="another unit"),
        pytest.param(8.0, -8.0, True, id="another sign"),
        pytest.param(-0.008, None, False, id="nothing stated"),
        pytest.param(2.0, 0.5, False, id="next to no bias"),
        pytest.param(1e4, None, True, id="more than a wheel holds"),
    ],
)
def test_a_first_record_that_cannot_be_that_of_the_spacecraft_refuses_the_telemetry(
    pitch_n_m_s, bias_n_m_s, is_refused
):
    before = flight(pitch_n_m_s, bias_n_m_s)
    after, _ = sensed(before)
    assert after.filter.sensors["is_refused"][0] == is_refused
    # telemetry that is refused moves no state
    assert same_numbers(after.filter, before.state.filter) == is_refused


def test_a_later_one_is_left_out_alone():
    good, wild = flight(-8.0, -8.0), flight(-1.0, -8.0)
    state, _ = sensed(good)
    later = replace(state, filter=state.filter.with_watch(epoch_us=ALIGNED_US + MINUTE))
    record = replace(wild.knowledge.momenta[0], epoch_us=ALIGNED_US + MINUTE)
    after, records = sensed(wild, later, wild.knowledge._replace(momenta=(record,)))
    assert records["is_impossible"].tolist() == [True]
    assert not after.filter.sensors["is_refused"][0]
    assert same_numbers(after.filter, state.filter)


def test_every_record_of_a_batch_is_used_once_in_its_order():
    """Of minutes before a row each counts; what is later, or older than 15 min, does not."""
    first = flight(-8.0, None)
    spacecraft, axes = first.knowledge.spacecraft, np.array(first.knowledge.spacecraft.wheels.axes)
    rng = np.random.default_rng(7)
    minutes = (-15.01, -15.0, -9.0, -4.0, 0.0, 1.0)
    batch = tuple(
        TelemetryRecord(
            ALIGNED_US + round(minute * MINUTE),
            wheel_momentum_n_m_s=tuple((rng.normal([0.3, -8.0, -0.2], 0.01) @ np.linalg.pinv(axes)).tolist()),
        )
        for minute in minutes
    )
    at_once = Stepped(spacecraft=spacecraft, momenta=batch)
    assert not len(sensed(at_once, knowledge=at_once.knowledge._replace(momenta=batch[:1]))[1]), "older than 15 min"
    # one of before the alignment serves while none follows
    _, records = sensed(at_once, knowledge=at_once.knowledge._replace(momenta=batch[:4]))
    assert records["epoch_us"].tolist() == [batch[3].epoch_us]
    first, records = sensed(at_once)
    assert (len(records), first.filter.sensors["newest_us"][0]) == (1, ALIGNED_US)
    alignment = replace(at_once.knowledge.alignment, epoch_us=ALIGNED_US - 60 * MINUTE)
    at_once.knowledge = at_once.knowledge._replace(alignment=alignment)
    state, records = sensed(at_once)
    assert records["epoch_us"].tolist() == [each.epoch_us for each in batch[1:5]]
    assert (state.filter.sensors["newest_us"][0], state.filter.sensors["skipped"][0]) == (ALIGNED_US, 0)
    one_by_one = at_once.state
    for record in batch[1:5]:
        one_by_one, _ = sensed(at_once, one_by_one, at_once.knowledge._replace(momenta=(record,)))
    np.testing.assert_array_equal(state.filter.covariance, one_by_one.filter.covariance)
    model, states = at_once.model.filter, len(state.filter.mean)
    begin = core_size(model, hidden_count(model, states)) - sensor_states(at_once.model.settings)
    own = slice(begin, begin + 3)
    sigmas = [np.sqrt(each.filter.covariance.diagonal()[own]) for each in (state, first)]
    assert (sigmas[0] < 0.75 * sigmas[1]).all()
    assert not len(sensed(at_once, state)[1])


def learned(number, factor):
    """Return a calibration whose quiet days told a torque."""
    made = PAYLOAD.calibration()
    assert made.result is not None
    mean = (*(factor * 1e-6 * part for part in range(1, 10)), 0.01, -0.01, 1e-3, 2e-3)
    gathered = GatheredTorque(mean, tuple(map(tuple, (1e-16 * np.eye(13)).tolist())), 800, 0)
    return replace(made, id=number, result=replace(made.result, gathered=gathered))


def test_a_calibration_with_another_torque_changes_nothing_in_a_filter_that_runs():
    spacecraft = PAYLOAD.spacecraft()
    stated = replace(spacecraft, onboard=replace(spacecraft.onboard, momentum=WheelMomentum()))
    old, new = (
        Stepped(spacecraft=stated, calibration=learned(number, factor)) for number, factor in ((1, 1.0), (2, 3.0))
    )
    assert old.model.settings.momentum != new.model.settings.momentum
    carried = carried_state(old.state, old.model, new.model)
    own = slice(core_size(new.model.filter), core_size(new.model.filter, 16))
    assert np.abs(old.state.filter.mean[own]).max() > 0.0
    np.testing.assert_array_equal(carried.filter.mean[own], old.state.filter.mean[own])
    # a filter that begins under it has its torque
    began = new.state.filter.mean[own][:9]
    np.testing.assert_allclose(began, 3.0 * old.state.filter.mean[own][:9], rtol=1e-9)


STATED = Polarimeter("p", 10.0, 11e9)


def read(angles_deg, *, is_used=True):
    """Return the state at an alignment, and after the angles of some minutes, in blocks of five."""
    craft = replace(PAYLOAD.spacecraft(), polarimeters=(replace(STATED, used=is_used),))
    flight = Stepped(spacecraft=craft)
    state, records = flight.state, []
    for minute, angle_deg in angles_deg.items():
        records.append(PolarizationRecord("p", ALIGNED_US + minute * MINUTE, angle_deg=angle_deg, sigma_deg=0.01))
        knowledge = flight.knowledge._replace(polarization={"p": tuple(records)})
        state = replace(state, filter=state.filter.with_watch(epoch_us=ALIGNED_US + minute * MINUTE))
        state, _ = sensed(flight, state, knowledge)
    return flight.state, state


def test_the_first_angle_sets_the_offset_and_a_change_after_it_counts_as_yaw():
    before, first = read({5: 1.7})
    yaw, sigma = ATTITUDE.start, np.sqrt(before.filter.covariance[0, 0])
    assert first.filter.sensors["newest_us"][1] == ALIGNED_US + 5 * MINUTE
    assert first.filter.mean[yaw] == pytest.approx(before.filter.mean[yaw], abs=0.05 * sigma)
    _, second = read({5: 1.7, 10: 1.74})
    assert second.filter.sensors["records"][1] > 1.9
    assert second.filter.mean[yaw] > first.filter.mean[yaw]


def test_an_angle_that_is_not_due_and_a_polarimeter_that_is_not_used_change_nothing():
    _, two = read({5: 1.7, 9: 1.9})
    _, one = read({5: 1.7})
    np.testing.assert_array_equal(two.filter.mean, one.filter.mean)
    before, unused = read({5: 1.7}, is_used=False)
    assert len(unused.filter.sensors) == 1
    assert same_numbers(unused.filter, before.filter)


def frozen_after(rows_dbm, period_us=MINUTE_US):
    """Return which carriers are frozen after each of some rows (T, N)."""
    epochs_us = period_us * np.arange(len(rows_dbm), dtype=np.int64)
    return frozen_readings(no_readings(len(rows_dbm[0])), epochs_us, np.array(rows_dbm, dtype=np.float64))[1]


def test_a_reading_that_stands_for_twenty_minutes_is_frozen_until_it_moves():
    rows = [[-40.0 + 0.1 * (k % 2), -50.0] for k in range(30)] + [[-40.0, -50.05]]
    answers = frozen_after(rows)
    assert not answers[:, 0].any()
    assert np.flatnonzero(answers[:, 1]).tolist() == list(range(20, 30))


@pytest.mark.parametrize(("period_us", "first"), [(1_000_000, 1200), (300_000_000, 19)])
def test_twenty_rows_and_twenty_minutes_are_both_needed(period_us, first):
    answers = frozen_after([[-40.0]] * (first + 2), period_us)[:, 0]
    assert np.flatnonzero(answers).tolist() == [first, first + 1]


def test_steps_of_a_decibel_are_coarse_and_those_of_real_links_are_not():
    rng = np.random.default_rng(11)
    fine_db = np.cumsum(rng.normal(0.0, 0.02, 300)) + rng.normal(0.0, 0.12, 300)
    answers = frozen_after(np.column_stack([np.round(fine_db / 0.15) * 0.15, np.round(3.0 * fine_db)]))
    assert not answers[:, 0].any()
    assert answers[60:, 1].all()


def test_six_readings_far_apart_make_a_carrier_coarse_and_a_fade_does_not():
    rows = [[-40.0], [-40.0], [-35.0], [-40.0], [-39.0], [-40.0], [-38.0], [-40.0]]
    assert np.flatnonzero(frozen_after(rows)[:, 0]).tolist() == [6, 7]


def test_one_step_of_a_user_leaves_the_carrier_out_for_a_row():
    levels = -40.0 + 0.1 * np.random.default_rng(12).normal(size=60)
    levels[30:] += 2.0
    assert not frozen_after(levels[:, None])[31:].any()


def test_an_absent_carrier_keeps_its_last_reading():
    rows = [[-40.0]] * 10 + [[np.nan]] * 30 + [[-40.0]] * 12
    answers = frozen_after(rows)[:, 0]
    assert not answers[:49].any()
    assert answers[49:].all()
