"""Claims about declared operations: what the ground told is no fault."""

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.model.declared import Declared, nothing_declared
from service.core.estimation.filtering.model.filter_model import FilterSettings, no_motion, pattern_change
from service.core.estimation.filtering.model.filter_state import CHAIN

MINUTE_US = 60_000_000
CARRIERS = 16
EVERYONE = np.arange(CARRIERS)
NONE = nothing_declared(CARRIERS, 3)


class Run:
    """A filter of a still craft, driven with declarations."""

    def __init__(self, filter_models):
        self.model, self.rng = filter_models.carrier_model(carriers=CARRIERS), np.random.default_rng(1)
        self.state = start(self.model, 0, filter_models.aligned(self.model))
        self.reported = []
        self.rows(60)

    def rows(self, count, change_db=0.0, declared: Declared | None = None):
        """Feed rows of white noise and a change (N,) or (), return what the last told."""
        for _ in range(count):
            row = change_db + self.model.white_sigma_db * self.rng.standard_normal(CARRIERS)
            epoch_us = self.state.epoch_us + MINUTE_US
            reported = step(self.model, FilterSettings(), self.state, epoch_us, row, no_motion(), declared=declared)
            self.reported.append(reported)
            self.state = reported.state
        return self.reported[-1]


@pytest.fixture
def run():
    return Run(filter_models)


def test_nothing_declared_changes_nothing():
    plain, reported = Run(filter_models).rows(5), Run(filter_models).rows(5, declared=NONE)
    np.testing.assert_array_equal(reported.attitude_deg, plain.attitude_deg)
    np.testing.assert_array_equal(reported.state.gaussian.covariance, plain.state.gaussian.covariance)


def test_masked_carriers_are_neither_used_nor_missed(run):
    masked = NONE._replace(is_masked=EVERYONE < 3)
    off_db = np.where(EVERYONE == 0, np.nan, np.where(EVERYONE == 1, -5.0, 0.0))
    reported = run.rows(90, off_db, masked)
    np.testing.assert_array_equal(reported.used, EVERYONE[3:])
    assert not reported.state.carriers.is_flagged.any()
    assert np.isnan(reported.innovation_db[:3]).all()
    assert len(run.rows(1).used) == CARRIERS


def test_a_row_of_masked_carriers_coasts(run):
    reported = run.rows(1, 0.0, NONE._replace(is_masked=EVERYONE >= 3))
    assert len(reported.used) == 0
    assert "redundancy" in reported.integrity.reasons


def test_declared_noise_is_believed_and_not_learned(run):
    before = run.state.noise.white_scale
    declared = NONE._replace(white_db=np.full(CARRIERS, 2.0))
    sigma = np.diagonal(run.reported[-1].covariance_deg2)
    reported = run.rows(15, 1.5 * run.rng.standard_normal(CARRIERS), declared)
    np.testing.assert_array_equal(reported.state.noise.white_scale, before)
    assert not reported.state.carriers.is_flagged.any()
    assert (np.diagonal(reported.covariance_deg2) > sigma).all()


def test_a_declared_step_of_a_carrier_is_no_fault(run):
    declared = NONE._replace(reference_step_db=np.where(EVERYONE == 5, 3.0, 0.0))
    before, change_db = run.reported[-1].attitude_deg, np.where(EVERYONE == 5, 2.2, 0.0)
    reported = run.rows(1, change_db, declared)
    reported = run.rows(30, change_db)
    assert all(len(row.used) == CARRIERS for row in run.reported[60:])
    assert reported.state.carriers.is_relearned[5]
    # 0.3 dB within thirty rows of white noise; the attitude moves by its own noise
    assert (np.abs(reported.attitude_deg - before) < [0.1, 0.03, 0.04]).all()


def test_a_declared_step_of_a_transponder_keeps_its_carriers_relation(run):
    declared = NONE._replace(group_step_db=np.array([0.0, 3.0, 0.0]))
    before, change_db = run.reported[-1].attitude_deg, np.where(run.model.transponder == 1, -1.7, 0.0)
    run.rows(1, change_db, declared)
    reported = run.rows(30, change_db)
    assert all(len(row.used) == CARRIERS and row.cause is None for row in run.reported[60:])
    assert not reported.state.carriers.is_relearned.any()
    assert (np.abs(reported.attitude_deg - before) < [0.1, 0.03, 0.04]).all()


@pytest.mark.parametrize("size_db", [2.5, -2.5])
def test_a_declared_step_of_the_chain_holds_control_and_is_no_rain(run, size_db):
    run.rows(1, size_db, NONE._replace(chain_step_db=3.0))
    reported = run.rows(30, size_db)
    assert sum("chain_step" in row.integrity.reasons for row in run.reported[60:]) == 10
    assert not any(row.state.rain.is_raining for row in run.reported[60:])
    assert abs(reported.state.gaussian.mean[CHAIN] - size_db) < 0.25  # what 16 carriers with 0.1 dB each share
    assert abs(reported.state.rain.base_chain_db - size_db) < 0.3


def test_a_declared_motion_is_followed_without_an_alarm(run):
    truth = np.array([0.0, 0.2, -0.2])
    change_db = pattern_change(run.model, truth).deviation_db
    run.rows(1, change_db, NONE._replace(attitude_step_deg=np.array([0.3, 0.3, 0.3])))
    reported = run.rows(30, change_db)
    assert np.abs(reported.attitude_deg - truth)[1:].max() < 0.06
    assert not any("unannounced_motion" in row.integrity.reasons for row in run.reported[60:])


def test_small_steps_of_every_row_hide_no_fault_and_hold_nothing(run):
    """An eclipse is told as a step of 0.04 dB a row of each transponder."""
    declared = NONE._replace(group_step_db=np.full(3, 0.04), chain_step_db=0.04)
    reported = run.rows(6, np.where(EVERYONE == 5, -4.0, 0.0), declared)
    assert reported.state.carriers.is_flagged[5]
    assert not any("chain_step" in row.integrity.reasons for row in run.reported[60:])


def test_a_fall_while_the_chain_is_worked_on_is_no_rain(run):
    working = NONE._replace(chain_walk_db=0.1)
    run.rows(5, 0.0, working)
    reported = run.rows(20, -2.5, working)
    assert not any(row.state.rain.is_raining for row in run.reported)
    assert sum("chain_step" in row.integrity.reasons for row in run.reported) == 10
    assert abs(reported.state.gaussian.mean[CHAIN] + 2.5) < 0.25  # what 16 carriers with 0.1 dB each share
    assert len(reported.used) == CARRIERS
