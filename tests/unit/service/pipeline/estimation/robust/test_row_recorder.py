"""The recorder keeps the final version of the rows, and says where a state came from."""

from types import SimpleNamespace

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.hidden_shares import with_share
from service.core.estimation.filtering.model.filter_model import FilterSettings, no_motion
from service.core.estimation.filtering.model.filter_state import core_size
from service.core.estimation.filtering.rows.row_kernels import ARRAYS
from service.pipeline.estimation.robust.row_recorder import RowRecorder

MINUTE_US, CARRIERS = 60_000_000, 6


@pytest.fixture
def model():
    carriers = filter_models.carrier_model(carriers=CARRIERS)
    names = tuple("abcdef")
    return SimpleNamespace(
        filter=carriers, settings=FilterSettings(), rate_sensor=None, calibration_id=1, carrier_ids=names
    )


def aligned(model):
    return start(model.filter, 0, filter_models.aligned(model.filter))


def run(recorder, model, state, rows, *, is_recorded=True, **known):
    """Take rows that swing and return the state after them."""
    for _ in range(rows):
        level_db = 0.1 * np.sin(state.epoch_us / MINUTE_US + np.arange(CARRIERS))
        kernels = recorder.capturing(ARRAYS) if is_recorded else ARRAYS
        motion = no_motion()._replace(**known)
        epoch_us = state.epoch_us + MINUTE_US
        found = step(model.filter, model.settings, state, epoch_us, level_db, motion, kernels=kernels)
        if is_recorded:
            recorder.push(model, state, found)
        state = found.state
    return state


def test_a_row_that_is_taken_again_replaces_itself_and_all_later_ones(model):
    recorder = RowRecorder(100)
    third = run(recorder, model, aligned(model), 3)
    run(recorder, model, third, 4)
    again = run(recorder, model, third, 2)
    assert [row.epoch_us // MINUTE_US for row in recorder.rows] == [1, 2, 3, 4, 5]
    assert recorder.rows[-1].mean is again.gaussian.mean
    np.testing.assert_array_equal(recorder.rows[3].origin, np.arange(len(third.gaussian.mean)))


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
    state = state._replace(gaussian=state.gaussian._replace(mean=state.gaussian.mean.copy()))
    run(recorder, other, state, 1)
    assert recorder.rows[-1].origin is None


def test_a_released_command_is_a_new_state_and_all_others_have_their_past(model):
    recorder = RowRecorder(100)
    state = run(recorder, model, aligned(model), 2)
    run(recorder, model, with_share(model.filter, state, 0), 1, unreported=np.zeros((1, 2, 3)))
    origin = recorder.rows[-1].origin
    assert np.flatnonzero(origin < 0).tolist() == [core_size(model.filter)]
    np.testing.assert_array_equal(np.delete(origin, core_size(model.filter)), np.arange(len(state.gaussian.mean)))


def test_a_row_that_is_not_newer_than_the_state_is_not_kept(model):
    recorder = RowRecorder(100)
    state = run(recorder, model, aligned(model), 2)
    kernels = recorder.capturing(ARRAYS)
    found = step(model.filter, model.settings, state, state.epoch_us, np.zeros(CARRIERS), no_motion(), kernels=kernels)
    recorder.push(model, state, found)
    assert len(recorder.rows) == 2


def test_memory_is_bounded(model):
    recorder = RowRecorder(5)
    run(recorder, model, aligned(model), 9)
    assert [row.epoch_us // MINUTE_US for row in recorder.rows] == [5, 6, 7, 8, 9]
