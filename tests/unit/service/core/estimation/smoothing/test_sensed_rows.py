"""Records of wheels and of a polarimeter between rows, on the way back: the dense solution of the same linear rows.

A record is linearised where the filter stood, so that rows and records together are a linear Gaussian case: what the
way back gives has to be the one conditional distribution of all noise.
"""

from typing import NamedTuple

import filter_models
import numpy as np
import pytest
from wheel_filter import WHEELS, H

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.hidden_shares import with_torque
from service.core.estimation.filtering.model.filter_model import FilterSettings, PolarimeterModel, no_motion
from service.core.estimation.filtering.model.filter_state import ATTITUDE, RAIN, Gaussian
from service.core.estimation.filtering.model.hidden_motion import momentum_count, sensors_first
from service.core.estimation.filtering.model.sensor_effect import SensorEffect
from service.core.estimation.filtering.model.wheel_momentum import FREE_N_M_S
from service.core.estimation.filtering.rows.row_kernels import ARRAYS
from service.core.estimation.filtering.watches.momentum_watch import fresh_watch, push_record
from service.core.estimation.filtering.watches.polarimeter_watch import AngleBlock, PolarimeterWatch, push_block
from service.core.estimation.smoothing.effective_row import EffectiveRow, effective_row, smoothed_rows
from service.core.estimation.smoothing.row_capture import StepCapture

MINUTE_US, CARRIERS, ROWS, UNLOADED = 60_000_000, 6, 14, 9
SETTINGS = FilterSettings(momentum=WHEELS, polarimeters=(PolarimeterModel((0.99, -0.09, -0.13)),))


class Taken(NamedTuple):
    """Row with the state before its records, the effect of each with the state after it, and the state in the end."""

    began: Gaussian
    records: list[tuple[SensorEffect, Gaussian]]
    after: Gaussian
    row: EffectiveRow


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=CARRIERS)


@pytest.fixture
def flown(model):
    """Return rows of a still spacecraft with an unloading of its wheels on the way."""
    print("seed 20261126")
    rng, capture = np.random.default_rng(20261126), StepCapture(ARRAYS)
    gaussian = with_torque(model, filter_models.aligned(model), SETTINGS)
    first = sensors_first(model, gaussian, SETTINGS)
    state, wheels, port, taken = start(model, 0, gaussian), fresh_watch(), PolarimeterWatch(0), []
    for number in range(ROWS):
        gaussian, at_us = state.gaussian, state.epoch_us
        records = []
        if number % 3 == 0 and number:
            unloaded = np.array([0.4, 0.0, -0.2]) if number >= UNLOADED else np.zeros(3)
            value = H + unloaded + rng.normal(0.0, 0.01, 3)
            is_unloading = number == UNLOADED
            wheels, gaussian, effect = push_record(
                wheels, gaussian, first, at_us - 20_000_000, value, at_us, SETTINGS, WHEELS, is_unloading=is_unloading
            )
            records.append((effect, gaussian))
        if number % 2 == 0:
            block = AngleBlock(at_us, 0.3 + rng.normal(0.0, 0.05), 0.05**2, -55.0)
            place = first + momentum_count(SETTINGS)
            port, gaussian, effect = push_block(port, gaussian, place, block, at_us, SETTINGS.polarimeters[0])
            records.append((effect, gaussian))
        sensed = state._replace(gaussian=gaussian)
        level_db = model.white_sigma_db * rng.standard_normal(CARRIERS)
        found = step(model, SETTINGS, sensed, at_us + MINUTE_US, level_db, no_motion(), kernels=capture.kernels)
        origin = np.arange(len(gaussian.mean)) if taken else None
        effects = [effect for effect, _ in records]
        row = effective_row(model, SETTINGS, sensed, found, capture.newest, origin, effects)
        taken.append(Taken(state.gaussian, records, found.state.gaussian, row))
        state = found.state
    assert not wheels.jumps
    assert not wheels.is_refused
    return taken


def dense(transition):
    matrix = np.diag(transition.factor)
    matrix[transition.targets] = 0.0
    matrix[np.ix_(transition.targets, transition.sources)] = transition.shares
    return matrix


def square_root(covariance):
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    assert values[0] > -1e-9
    return vectors * np.sqrt(np.maximum(values, 0.0))


class Dense:
    """All noise of a span: each state is an affine function of it, each measurement says something about it."""

    def __init__(self, gaussian):
        self.mean, self.root = gaussian.mean, square_root(gaussian.covariance)
        self.precision, self.vector = [], []

    def grow(self, root):
        self.root = np.hstack([self.root, root])

    def restart(self, positions, mean, sigma):
        self.mean, self.root = self.mean.copy(), self.root.copy()
        self.mean[positions], self.root[positions] = mean, 0.0
        fresh = np.zeros((len(self.mean), len(positions)))
        fresh[positions] = sigma * np.eye(len(positions))
        self.grow(fresh)

    def measure(self, row, gaussian):
        """Take a whitened row, whose noise is what its innovation has beside the state of the filter."""
        noise = np.eye(len(row.residual)) - row.cross @ row.jacobian.T
        jacobian, left = row.jacobian @ self.root, row.residual + row.jacobian @ (gaussian.mean - self.mean)
        solved = np.linalg.solve(noise, np.column_stack([jacobian, left]))
        self.precision.append(jacobian.T @ solved[:, :-1])
        self.vector.append(jacobian.T @ solved[:, -1])

    def answer(self, states):
        """Return the attitude of states, each the mean and root of its time, after everything."""
        size = self.root.shape[1]
        precision, vector = np.eye(size), np.zeros(size)
        for part, right in zip(self.precision, self.vector, strict=True):
            precision[: len(part), : len(part)] += part
            vector[: len(right)] += right
        covariance = np.linalg.inv(precision)
        for mean, root in states:
            wide = np.zeros((3, size))
            wide[:, : root.shape[1]] = root[ATTITUDE]
            yield mean[ATTITUDE] + wide @ covariance @ vector, wide @ covariance @ wide.T


def before_update(gaussian, update):
    """Return the state that a whitened update moved."""
    mean = gaussian.mean - update.residual @ update.cross
    return gaussian._replace(mean=mean, covariance=gaussian.covariance + update.cross.T @ update.cross)


def dense_solution(taken):
    """Return the attitude after each row by the dense solution, and how many states began again."""
    span, states, restarts = Dense(taken[0].began), [], 0
    for began, records, after, row in taken:
        filtered = began
        for (_, moved), record in zip(records, row.sensed, strict=True):
            found = moved if record.update is None else before_update(moved, record.update)
            if len(record.restarted):
                span.restart(record.restarted, found.mean[record.restarted], FREE_N_M_S)
                restarts += 1
            else:
                span.grow(square_root(found.covariance - filtered.covariance))
            if record.update is not None:
                span.measure(record.update, found)
            filtered = moved
        pushed = after._replace(mean=after.mean - after.covariance[:, RAIN] * row.rain_push)
        predicted, matrix = before_update(pushed, row.update), dense(row.step)
        span.mean = predicted.mean + matrix @ (span.mean - filtered.mean)
        span.root = matrix @ span.root
        span.grow(square_root(predicted.covariance - matrix @ filtered.covariance @ matrix.T))
        span.measure(row.update, predicted)
        span.precision.append(np.zeros((1, 1)))
        span.vector.append(row.rain_push * span.root[RAIN])
        states.append((span.mean, span.root))
    return list(span.answer(states)), restarts


def test_a_linear_gaussian_case_with_records_equals_the_dense_solution(flown):
    rows = [each.row for each in flown]
    updates = [record.update for row in rows for record in row.sensed if record.update is not None]
    assert sorted(len(update.residual) for update in updates) == [1] * 7 + [3] * 4
    found, restarts = dense_solution(flown)
    assert restarts == 1
    for own, (mean, covariance) in zip(smoothed_rows(rows), found[::-1], strict=True):
        np.testing.assert_allclose(own.mean[ATTITUDE], mean, atol=1e-9)
        np.testing.assert_allclose(own.covariance[ATTITUDE, ATTITUDE], covariance, atol=1e-9)


def test_smoothed_sigma_is_never_above_the_filters(flown):
    smoothed = list(smoothed_rows([each.row for each in flown]))[::-1]
    for own, each in zip(smoothed[:-1], flown, strict=False):
        assert (np.diag(own.covariance) < np.diag(each.after.covariance)[: len(own.mean)]).all()
