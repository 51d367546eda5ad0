"""The filter from row to row: what it makes of rain, steps, faults, motion and declared operations."""

import filter_models
import numpy as np
import pytest
from filter_rows import step

from service.core.estimation.filtering.common_cause import ATTITUDE_JUMP, COMMON, GROUP, INDEPENDENT, NOTHING
from service.core.estimation.filtering.filter_model import CHAIN, KnownMotion, no_motion, pattern_change
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.plant import filter_model
from service.core.estimation.filtering.row_block import nothing_declared

MINUTE_US = 60_000_000
CARRIERS = 16
EVERYONE = np.arange(CARRIERS)
NONE = nothing_declared(CARRIERS, 3)


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=CARRIERS)


class Run:
    """A filter driven by levels of a still craft."""

    def __init__(self, model, seed=1, period_us=MINUTE_US):
        self.model, self.compiled, self.period_us = model, filter_model(model), period_us
        self.rng = np.random.default_rng(seed)
        self.state = start(model, 0, filter_models.aligned(model))
        self.reported = []

    def rows(self, count, change_db=0.0, known=None, **options):
        """Feed rows of white noise and a change (N,) or (), return what the last told."""
        for _ in range(count):
            row = change_db + self.model.white_sigma_db * self.rng.standard_normal(CARRIERS)
            epoch_us = self.state.epoch_us + self.period_us
            self.reported.append(step(self.compiled, self.state, epoch_us, row, known or no_motion(), **options))
            self.state = self.reported[-1].state
        return self.reported[-1]


@pytest.fixture
def run(model):
    return Run(model)


def absent(*carriers):
    return np.where(np.isin(EVERYONE, carriers), np.nan, 0.0)


def test_a_still_craft_is_tracked_and_allowed(run):
    reported = run.rows(300)
    assert (np.abs(reported.attitude_deg) < 4.0 * reported.sigma_deg).all()
    assert reported.integrity.is_control_allowed
    assert all(row.cause == NOTHING for row in run.reported)
    assert len(reported.used) == CARRIERS


def test_a_row_whose_numbers_are_lost_is_told_and_keeps_the_state(run):
    run.rows(5)
    before = filter_models.bits(run.state)
    with pytest.raises(ArithmeticError, match="lost its numbers"):
        run.rows(1, known=no_motion()._replace(correction_deg=np.full(3, np.nan)))
    assert filter_models.bits(run.state) == before


def test_late_and_duplicate_rows_leave_the_state_as_it_is(run):
    run.rows(5)
    for epoch_us in (run.state.epoch_us, run.state.epoch_us - 1, 0):
        reported = step(run.compiled, run.state, epoch_us, np.full(CARRIERS, 9.0), no_motion())
        assert reported.state is run.state
        assert len(reported.used) == 0
        assert not reported.integrity.is_control_allowed


def test_a_step_does_not_change_the_state_it_is_given(run):
    run.rows(3)
    before = run.state
    mean, covariance = before.mean.copy(), before.covariance.copy()
    run.rows(1, -3.0)
    np.testing.assert_array_equal(before.mean, mean)
    np.testing.assert_array_equal(before.covariance, covariance)
    assert not before.watch["is_raining"][0]


def test_rain_over_the_site_stops_control_and_not_the_estimate(run):
    run.rows(60)
    reported = run.rows(60, -3.0 * run.model.rain_share)
    assert reported.state.watch["is_raining"][0]
    assert "downlink_fade" in reported.integrity.reasons
    assert abs(reported.row["rain_db"] - 3.0) < 0.3  # the median row: 0.06 dB, what else is common: some 0.1
    assert np.abs(reported.attitude_deg).max() < 0.1
    assert {row.cause for row in run.reported[60:]} <= {COMMON, NOTHING}
    assert not run.rows(30).state.watch["is_raining"][0]


@pytest.mark.parametrize("size_db", [3.0, 0.5])
def test_a_step_up_of_the_chain_holds_control_for_ten_minutes(run, size_db):
    before = run.rows(60).attitude_deg
    run.rows(20, size_db)
    reasons = ["chain_step" in row.integrity.reasons for row in run.reported[60:]]
    assert sum(reasons) == 10
    assert np.argmax(reasons) <= 8
    assert (np.abs(run.reported[-1].attitude_deg - before) < [0.08, 0.02, 0.03]).all()
    assert abs(run.state.mean[CHAIN] - size_db) < 0.25


def test_a_carrier_that_steps_is_left_out_and_learned_anew(run):
    run.rows(60)
    change_db = np.where(EVERYONE == 5, 1.5, 0.0)
    run.rows(4, change_db)
    assert run.state.carriers["is_flagged"][5]
    reported = run.rows(75, change_db)
    assert not reported.state.carriers["is_flagged"].any()
    assert reported.state.carriers["is_relearned"][5]
    assert 5 in reported.used


def test_a_group_step_keeps_all_carriers_and_the_attitude(run):
    before = run.rows(60).attitude_deg
    reported = run.rows(30, np.where(run.model.transponder == 1, -1.5, 0.0))
    assert GROUP in {row.cause for row in run.reported[60:]}
    assert len(reported.used) == CARRIERS
    assert (np.abs(reported.attitude_deg - before) < [0.1, 0.03, 0.04]).all()


def test_a_jump_of_the_attitude_is_followed_and_told(run):
    run.rows(60)
    truth = np.array([0.0, 0.4, -0.4])
    change_db = pattern_change(run.model, truth).deviation_db
    run.rows(1, change_db)
    assert run.reported[-1].cause == ATTITUDE_JUMP
    assert "unannounced_motion" in run.reported[-1].integrity.reasons
    reported = run.rows(60, change_db)
    assert np.abs(reported.attitude_deg - truth)[1:].max() < 0.06


def test_a_correction_that_was_lost_is_alarmed_and_followed(run):
    zeros = np.zeros(3)
    lost = KnownMotion(np.array([0.0, 0.15 / 30.0, 0.0]), zeros, zeros)
    run.rows(60)
    run.rows(30, known=lost)
    reported = run.rows(10)
    alarmed = ["unannounced_motion" in row.integrity.reasons for row in run.reported[60:]]
    assert any(alarmed)
    assert np.argmax(alarmed) <= 30  # minutes
    assert abs(reported.attitude_deg[1]) < 0.06


def test_faults_of_several_single_carriers_leave_the_others(run):
    run.rows(20)
    faults_db = np.where(EVERYONE < 5, [-9.0, 6.0, -5.0, 8.0, -12.0] + [0.0] * 11, 0.0)
    run.rows(1, faults_db)
    assert run.reported[-1].cause == INDEPENDENT
    assert sorted(run.reported[-1].used) == list(range(5, CARRIERS))


def test_a_row_that_nobody_survives_is_a_row_without_an_update(run):
    run.rows(20)
    # as much up as down: no cause moves all of them so
    reported = run.rows(1, 50.0 * (-1.0) ** EVERYONE)
    assert len(reported.used) == 0
    assert np.abs(reported.attitude_deg).max() < 0.2


def test_too_few_carriers_of_the_full_band_leave_the_common_test_out(run):
    run.rows(20)
    reported = run.rows(
        30, absent(*range(2, 12)) - 2.0 * run.model.rain_share
    )  # two of the full band, four of the other
    assert reported.cause == NOTHING
    assert not reported.state.watch["is_raining"][0]


def test_ten_second_rows_are_flagged_by_the_minute(model):
    run = Run(model, period_us=10_000_000)
    run.rows(60)
    change_db = np.where(EVERYONE == 5, 1.5, 0.0)
    run.rows(6, change_db)
    assert not run.state.carriers["is_flagged"][5]
    run.rows(18, change_db)
    assert run.state.carriers["is_flagged"][5]


def test_a_carrier_that_was_off_shows_its_level_first(run):
    run.rows(60)
    run.rows(40, absent(5))
    assert run.state.carriers["is_flagged"][5]
    before = run.reported[-1].attitude_deg
    change_db = np.where(EVERYONE == 5, 0.45, 0.0)  # 2.5 sigma
    run.rows(1, change_db)
    assert 5 not in run.reported[-1].used
    assert (np.abs(run.reported[-1].attitude_deg - before) < [0.02, 0.005, 0.005]).all()
    reported = run.rows(75, change_db)
    assert 5 in reported.used
    assert reported.state.carriers["is_relearned"][5]


def test_a_gap_of_all_carriers_flags_nobody(run):
    run.rows(60)
    run.rows(60, absent(*EVERYONE))
    assert len(run.rows(2).used) >= CARRIERS - 1


@pytest.fixture
def settled(run):
    run.rows(60)
    return run


def test_nothing_declared_changes_nothing(model):
    plain, reported = Run(model).rows(5), Run(model).rows(5, declared=NONE)
    np.testing.assert_array_equal(reported.attitude_deg, plain.attitude_deg)
    np.testing.assert_array_equal(reported.state.covariance, plain.state.covariance)


def test_declared_noise_is_believed_and_not_learned(settled):
    before = settled.state.carriers["white_scale"]
    declared = NONE._replace(white_db=np.full(CARRIERS, 2.0))
    sigma = settled.reported[-1].sigma_deg
    reported = settled.rows(15, 1.5 * settled.rng.standard_normal(CARRIERS), declared=declared)
    np.testing.assert_array_equal(reported.state.carriers["white_scale"], before)
    assert not reported.state.carriers["is_flagged"].any()
    assert (reported.sigma_deg > sigma).all()


@pytest.mark.parametrize("size_db", [2.5, -2.5])
def test_a_declared_step_of_the_chain_holds_control_and_is_no_rain(settled, size_db):
    settled.rows(1, size_db, declared=NONE._replace(chain_step_db=3.0))
    reported = settled.rows(30, size_db)
    assert sum("chain_step" in row.integrity.reasons for row in settled.reported[60:]) == 10
    assert not any(row.state.watch["is_raining"][0] for row in settled.reported[60:])
    assert abs(reported.state.mean[CHAIN] - size_db) < 0.25  # what 16 carriers with 0.1 dB each share
    assert abs(reported.state.watch["base_chain_db"][0] - size_db) < 0.3


def test_small_steps_of_every_row_hide_no_fault_and_hold_nothing(settled):
    """An eclipse is told as a step of 0.04 dB a row of each transponder."""
    declared = NONE._replace(group_step_db=np.full(3, 0.04), chain_step_db=0.04)
    reported = settled.rows(6, np.where(EVERYONE == 5, -4.0, 0.0), declared=declared)
    assert reported.state.carriers["is_flagged"][5]
    assert not any("chain_step" in row.integrity.reasons for row in settled.reported[60:])


def test_a_fall_while_the_chain_is_worked_on_is_no_rain(settled):
    working = NONE._replace(chain_walk_db=0.1)
    settled.rows(5, 0.0, declared=working)
    reported = settled.rows(20, -2.5, declared=working)
    assert not any(row.state.watch["is_raining"][0] for row in settled.reported)
    assert sum("chain_step" in row.integrity.reasons for row in settled.reported) == 10
    assert abs(reported.state.mean[CHAIN] + 2.5) < 0.25  # what 16 carriers with 0.1 dB each share
    assert len(reported.used) == CARRIERS
