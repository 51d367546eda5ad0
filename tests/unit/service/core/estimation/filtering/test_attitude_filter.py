"""The filter from start to update."""

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.anchor import ERROR_SIGMA_DEG
from service.core.estimation.filtering.anchor import Mixture
from service.core.estimation.filtering.attitude_filter import start, start_again, step
from service.core.estimation.filtering.state_changes import carry_over
from service.core.estimation.filtering.common_cause import Cause, LikeliestCause
from service.core.estimation.filtering.filter_predict import Weather, predict
from service.core.estimation.filtering.filter_update import innovate, site_db, update
from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    CHAIN,
    DRIFT,
    FREE_REFERENCE_DB2,
    RAIN,
    CarrierModel,
    FilterSettings,
    Gaussian,
    KnownMotion,
    carrier_states,
    core_size,
    no_motion,
    pattern_change,
    reference_states,
)
from service.core.estimation.filtering.integrity import IntegrityLimits

MINUTE_US = 60_000_000
CARRIERS = 16
EVERYONE = np.arange(CARRIERS)
SETTINGS = FilterSettings()


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=CARRIERS)


class Run:
    """A filter driven by levels of a still craft."""

    def __init__(self, filter_models, model, seed=1, period_us=MINUTE_US):
        self.model, self.rng, self.period_us = model, np.random.default_rng(seed), period_us
        self.state = start(model, 0, filter_models.aligned(model))
        self.reported = []

    def rows(self, count, change_db=0.0, known=None, **options):
        """Feed rows of white noise and a change (N,) or (), return what the last told."""
        for _ in range(count):
            row = change_db + self.model.white_sigma_db * self.rng.standard_normal(CARRIERS)
            epoch_us = self.state.epoch_us + self.period_us
            self.reported.append(step(self.model, SETTINGS, self.state, epoch_us, row, known or no_motion(), **options))
            self.state = self.reported[-1].state
        return self.reported[-1]


@pytest.fixture
def run(model):
    return Run(filter_models, model)


def absent(*carriers):
    return np.where(np.isin(EVERYONE, carriers), np.nan, 0.0)


def test_a_still_craft_is_tracked_and_allowed(run):
    reported = run.rows(300)
    assert (np.abs(reported.attitude_deg) < 4.0 * np.sqrt(np.diagonal(reported.covariance_deg2))).all()
    assert reported.integrity.is_control_allowed
    assert all(row.cause is None for row in run.reported)
    assert len(reported.used) == CARRIERS


def test_late_and_duplicate_rows_leave_the_state_as_it_is(run):
    run.rows(5)
    for epoch_us in (run.state.epoch_us, run.state.epoch_us - 1, 0):
        reported = step(run.model, SETTINGS, run.state, epoch_us, np.full(CARRIERS, 9.0), no_motion())
        assert reported.state is run.state
        assert len(reported.used) == 0
        assert not reported.integrity.is_control_allowed


def test_a_step_does_not_change_the_state_it_is_given(run):
    run.rows(3)
    before = run.state
    mean, covariance = before.gaussian.mean.copy(), before.gaussian.covariance.copy()
    run.rows(1, -3.0)
    np.testing.assert_array_equal(before.gaussian.mean, mean)
    np.testing.assert_array_equal(before.gaussian.covariance, covariance)
    assert not before.rain.is_raining


def test_rain_over_the_site_stops_control_and_not_the_estimate(run):
    run.rows(60)
    reported = run.rows(60, -3.0 * run.model.rain_share)
    assert reported.state.rain.is_raining
    assert "downlink_fade" in reported.integrity.reasons
    assert abs(reported.rain_db - 3.0) < 0.3  # the median row is good to 0.06 dB, what else is common to some 0.1
    assert np.abs(reported.attitude_deg).max() < 0.1
    assert {row.cause for row in run.reported[60:]} <= {Cause.COMMON, None}
    assert not run.rows(30).state.rain.is_raining


@pytest.mark.parametrize("size_db", [3.0, 0.5])
def test_a_step_up_of_the_chain_holds_control_for_ten_minutes(run, size_db):
    before = run.rows(60).attitude_deg
    run.rows(20, size_db)
    reasons = ["chain_step" in row.integrity.reasons for row in run.reported[60:]]
    assert sum(reasons) == 10
    assert np.argmax(reasons) <= 8
    assert (np.abs(run.reported[-1].attitude_deg - before) < [0.08, 0.02, 0.03]).all()
    assert abs(run.state.gaussian.mean[CHAIN] - size_db) < 0.25


def test_a_carrier_that_steps_is_left_out_and_learned_anew(run):
    run.rows(60)
    change_db = np.where(EVERYONE == 5, 1.5, 0.0)
    run.rows(4, change_db)
    assert run.state.carriers.is_flagged[5]
    reported = run.rows(75, change_db)
    assert not reported.state.carriers.is_flagged.any()
    assert reported.state.carriers.is_relearned[5]
    assert 5 in reported.used


def test_a_group_step_keeps_all_carriers_and_the_attitude(run):
    before = run.rows(60).attitude_deg
    reported = run.rows(30, np.where(run.model.transponder == 1, -1.5, 0.0))
    assert Cause.GROUP in {row.cause for row in run.reported[60:]}
    assert len(reported.used) == CARRIERS
    assert (np.abs(reported.attitude_deg - before) < [0.1, 0.03, 0.04]).all()


def test_a_jump_of_the_attitude_is_followed_and_told(run):
    run.rows(60)
    truth = np.array([0.0, 0.4, -0.4])
    change_db = pattern_change(run.model, truth).deviation_db
    run.rows(1, change_db)
    assert run.reported[-1].cause is Cause.ATTITUDE
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


def test_the_chooser_is_the_callers(run):
    seen = []

    def chooser(model, innovation):
        seen.append(len(innovation.carriers))
        return LikeliestCause(Cause.INDEPENDENT)

    run.rows(20)
    run.rows(1, np.where(EVERYONE < 8, -4.0, 0.0), chooser=chooser, limits=IntegrityLimits())
    assert seen == [CARRIERS]
    assert run.reported[-1].cause is Cause.INDEPENDENT
    assert sorted(run.reported[-1].used) == list(range(8, CARRIERS))


def test_a_row_that_nobody_survives_is_a_row_without_an_update(run):
    run.rows(20)
    reported = run.rows(
        1, 50.0 * (-1.0) ** EVERYONE, chooser=lambda _model, _innovation: LikeliestCause(Cause.INDEPENDENT)
    )
    assert len(reported.used) == 0
    assert np.abs(reported.attitude_deg).max() < 0.2


def test_too_few_carriers_of_the_full_band_leave_the_common_test_out(run):
    run.rows(20)
    reported = run.rows(
        30, absent(*range(2, 12)) - 2.0 * run.model.rain_share
    )  # two of the full band, four of the other
    assert reported.cause is None
    assert not reported.state.rain.is_raining


def test_ten_second_rows_are_flagged_by_the_minute(model):
    run = Run(filter_models, model, period_us=10_000_000)
    run.rows(60)
    change_db = np.where(EVERYONE == 5, 1.5, 0.0)
    run.rows(6, change_db)
    assert not run.state.carriers.is_flagged[5]
    run.rows(18, change_db)
    assert run.state.carriers.is_flagged[5]


def test_a_carrier_that_was_off_shows_its_level_first(run):
    run.rows(60)
    run.rows(40, absent(5))
    assert run.state.carriers.is_flagged[5]
    before = run.reported[-1].attitude_deg
    change_db = np.where(EVERYONE == 5, 0.45, 0.0)  # 2.5 sigma
    run.rows(1, change_db)
    assert 5 not in run.reported[-1].used
    assert (np.abs(run.reported[-1].attitude_deg - before) < [0.02, 0.005, 0.005]).all()
    reported = run.rows(75, change_db)
    assert 5 in reported.used
    assert reported.state.carriers.is_relearned[5]


def test_a_gap_of_all_carriers_flags_nobody(run):
    run.rows(60)
    run.rows(60, absent(*EVERYONE))
    assert len(run.rows(2).used) >= CARRIERS - 1


def walked(model, aligned, rows=30):
    """Return a state with correlations of every kind."""
    weather = Weather(True, (False, False, False), 1.0, np.zeros(model.carriers))
    rng, state = np.random.default_rng(8), aligned
    for _ in range(rows):
        state, _ = predict(model, FilterSettings(), state, 60_000_000, no_motion(), weather)
        row = 0.2 * rng.standard_normal(model.carriers)
        row_innovation = innovate(model, state, row, np.arange(model.carriers), model.white_sigma_db**2)
        state = update(model, state, row, row_innovation).state
    return state


def dense_jacobian(model, mean, carriers):
    matrix = np.zeros((len(carriers), len(mean)))
    matrix[:, ATTITUDE] = pattern_change(model, mean[ATTITUDE]).gradient_db_deg[carriers]
    matrix[:, CHAIN : core_size(model)] = 1.0
    matrix[:, RAIN] = -model.rain_share[carriers]
    for number, positions in enumerate(carrier_states(model, carriers).T):
        matrix[number, positions] = 1.0
    return matrix


def expected_db(model, mean):
    """Return the levels that a state makes: those from which nothing is left over."""
    state, nothing = Gaussian(mean, np.eye(len(mean))), np.zeros(model.carriers)
    return -innovate(model, state, nothing, np.arange(model.carriers), model.white_sigma_db**2).innovation_db


def test_the_blocks_make_the_update_of_the_textbook():
    model = filter_models.carrier_model(common=1)
    state = walked(model, filter_models.aligned(model))
    carriers = np.array([0, 2, 3, 7, 11])
    row = 0.1 * np.random.default_rng(2).standard_normal(model.carriers) + expected_db(model, state.mean)
    innovation = innovate(model, state, row, carriers, model.white_sigma_db**2)
    jacobian = dense_jacobian(model, state.mean, carriers)
    white = np.diag(model.white_sigma_db[carriers] ** 2)
    spread = jacobian @ state.covariance @ jacobian.T + white
    gain = state.covariance @ jacobian.T @ np.linalg.inv(spread)
    kept = np.eye(len(state.mean)) - gain @ jacobian
    reported = update(model, state, row, innovation)
    # products of some hundred terms near one
    np.testing.assert_allclose(innovation.covariance_db2, spread, rtol=1e-10, atol=1e-14)
    np.testing.assert_allclose(
        reported.state.covariance, kept @ state.covariance @ kept.T + gain @ white @ gain.T, rtol=1e-8, atol=1e-13
    )
    np.testing.assert_allclose(reported.state.mean, state.mean + gain @ innovation.innovation_db, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(
        reported.nis, innovation.innovation_db @ np.linalg.solve(spread, innovation.innovation_db)
    )
    shift = (gain @ innovation.innovation_db)[ATTITUDE] / np.sqrt(np.diagonal(gain @ spread @ gain.T)[ATTITUDE])
    np.testing.assert_allclose(reported.attitude_shift, shift, rtol=1e-9)
    assert reported.degrees == 5


def test_expected_levels_are_the_sum_of_all_parts():
    model = filter_models.carrier_model(common=1)
    mean = np.zeros(len(filter_models.aligned(model).mean))
    mean[[CHAIN, RAIN, 11]] = 0.5, 2.0, 0.25
    np.testing.assert_allclose(site_db(model, mean), 0.75 - 2.0 * model.rain_share)
    mean[carrier_states(model, np.array([3]))[:, 0]] = 1.0
    np.testing.assert_allclose(expected_db(model, mean)[[2, 3]], site_db(model, mean)[[2, 3]] + [0.0, 3.0])


def test_a_large_jump_is_linearised_where_it_leads():
    model = filter_models.carrier_model(carriers=24)
    state = filter_models.aligned(model)
    wide = state.covariance.copy()
    wide[ATTITUDE, ATTITUDE] += 0.3**2 * np.eye(3)
    truth = np.array([0.3, -0.4, 0.35])
    row = pattern_change(model, truth).deviation_db
    jumped = Gaussian(state.mean, wide)
    innovation = innovate(model, jumped, row, np.arange(24), model.white_sigma_db**2)
    once = (np.linalg.solve(innovation.covariance_db2, innovation.cross).T @ innovation.innovation_db)[ATTITUDE]
    reported = update(model, jumped, row, innovation)
    error = reported.state.mean[ATTITUDE] - truth
    # noise-free levels; what remains is the pull of the prior, well inside the sigma that is told
    assert (np.abs(error) < reported.state.attitude_sigma_deg).all()
    assert np.abs(error[1:]).max() < 0.03
    assert np.abs(once - truth)[1:].max() > np.abs(error[1:]).max()


def test_rain_never_falls_below_zero():
    model = filter_models.carrier_model()
    state = walked(model, filter_models.aligned(model))
    row = expected_db(model, state.mean) + 1.0
    reported = update(
        model, state, row, innovate(model, state, row, np.arange(model.carriers), model.white_sigma_db**2)
    )
    assert reported.state.mean[RAIN] == 0.0


def test_passes_of_linearisation_are_limited():
    model = filter_models.carrier_model(carriers=24)
    state = filter_models.aligned(model)
    wide = state.covariance + 0.0
    wide[ATTITUDE, ATTITUDE] += 4.0 * np.eye(3)
    row = 20.0 * (-1.0) ** np.arange(24)  # no attitude makes these
    lost = Gaussian(state.mean, wide)
    reported = update(model, lost, row, innovate(model, lost, row, np.arange(24), model.white_sigma_db**2))
    assert np.isfinite(reported.state.mean).all()
    assert np.linalg.eigvalsh(reported.state.covariance).min() > 0.0


ERROR_DEG = np.array([0.1, -0.2, 0.15])
FEW = 6


@pytest.fixture
def few():
    return filter_models.carrier_model(carriers=FEW)


@pytest.fixture
def state(few):
    """Return a filter that learned references: carrier 1 is set aside, 2 has a level of its own."""
    gaussian = filter_models.aligned(few)
    mean = gaussian.mean.copy()
    mean[reference_states(few, np.arange(FEW))] = [0.3, 0.0, 1.5, -0.4, 0.0, 0.0]
    mean[DRIFT] = 0.01
    state = start(few, 0, Gaussian(mean, gaussian.covariance))
    watch = state.carriers._replace(is_flagged=np.arange(FEW) == 1, is_relearned=np.isin(np.arange(FEW), [0, 2, 3]))
    return state._replace(carriers=watch)


def mixture(likeliest=("dry", "dry", "learned", "rain", "dry", "dry")):
    place = {"dry": 0, "rain": 2, "changed": 3, "learned": 4}
    told = np.full((FEW, 5), 0.025)
    told[np.arange(FEW), [place[each] for each in likeliest]] = 0.9
    return Mixture(np.ones(1), ERROR_DEG[None], np.diag([0.01, 0.0004, 0.0009])[None], told)


def test_the_attitude_moves_by_the_error_and_is_free(few, state):
    after = start_again(few, state, mixture()).gaussian
    np.testing.assert_allclose(after.mean[ATTITUDE], state.gaussian.mean[ATTITUDE] + ERROR_DEG)
    sigma_deg = np.hypot(ERROR_SIGMA_DEG, state.gaussian.attitude_sigma_deg)
    np.testing.assert_allclose(after.covariance[ATTITUDE, ATTITUDE], np.diag(sigma_deg**2))
    assert not after.covariance[ATTITUDE, 3:].any()
    np.testing.assert_array_equal(after.mean[DRIFT], state.gaussian.mean[DRIFT])


def test_dry_carriers_have_the_reference_of_the_alignment_again(few, state):
    after = start_again(few, state, mixture())
    positions = reference_states(few, np.array([0, 1, 4]))
    np.testing.assert_array_equal(after.gaussian.mean[positions], 0.0)
    assert not after.carriers.is_flagged[[0, 1, 4]].any()
    assert not after.carriers.is_relearned[[0, 1, 4]].any()


def test_wet_carriers_are_set_aside_and_learned_levels_stay(few, state):
    after = start_again(few, state, mixture())
    assert np.flatnonzero(after.carriers.is_flagged).tolist() == [3]
    # it comes back to the level of the alignment, not to the one that rain taught
    assert after.carriers.saved_reference_db[3] == 0.0
    assert after.gaussian.mean[reference_states(few, np.array([2]))] == 1.5


def test_a_carrier_without_a_reference_of_the_alignment_is_never_given_one(few, state):
    known = np.where(np.arange(FEW) == 4, np.nan, 0.0)
    unknown = state._replace(carriers=state.carriers._replace(aligned_reference_db=known))
    after = start_again(few, unknown, mixture())
    assert after.carriers.is_flagged[4]
    assert np.isfinite(after.gaussian.mean).all()


def test_the_level_is_that_of_the_moved_attitude(few, state):
    after = start_again(few, state, mixture())
    # 3.891 sigma of an error that is expected to be zero now
    np.testing.assert_allclose(after.anchor.level_deg, 3.8906 * np.array([0.1, 0.02, 0.03]), rtol=1e-3)


#: carriers 3 and 7 leave, the rest is turned round, two new ones come last
PLACE = np.array([11, 10, 9, 8, 6, 5, 4, 2, 1, 0, -1, -1])
STAYING = PLACE >= 0


def picked(model, position):
    """Return the model of a plan made of another's carriers; new ones are copies of carrier 3."""
    rows = np.where(position >= 0, position, 3)
    shared = ("common_sigma_db", "common_tau_s")
    return CarrierModel(*[v if n in shared else v[rows] for n, v in model._asdict().items()])


def driven(model, steered, count, rng, change_db=0.0):
    """Return what the last of some rows told."""
    for _ in range(count):
        row = change_db + model.white_sigma_db * rng.standard_normal(model.carriers)
        reported = step(model, SETTINGS, steered, steered.epoch_us + MINUTE_US, row, no_motion())
        steered = reported.state
    return reported


@pytest.fixture
def old():
    return filter_models.carrier_model(common=1)


@pytest.fixture
def steered(old):
    steps_db = np.where(np.arange(old.carriers) == 5, 2.0, 0.0)
    return driven(old, start(old, 0, filter_models.aligned(old)), 90, np.random.default_rng(2), steps_db).state


def changed(old, steered, position=PLACE, reference_db=0.0, is_unknown=False):
    count = len(position)
    args = np.full(count, reference_db), np.full(count, 0.5), np.broadcast_to(np.asarray(is_unknown), count)
    return carry_over(old, picked(old, position), steered, position, *args)


def test_the_same_plan_is_the_same_state(old, steered):
    same = changed(old, steered, np.arange(old.carriers))
    np.testing.assert_array_equal(same.gaussian.mean, steered.gaussian.mean)
    np.testing.assert_array_equal(same.gaussian.covariance, steered.gaussian.covariance)
    np.testing.assert_array_equal(same.carriers.is_flagged, steered.carriers.is_flagged)
    np.testing.assert_array_equal(same.minute.total, steered.minute.total)
    np.testing.assert_array_equal(same.noise.white_scale, steered.noise.white_scale)


def test_staying_carriers_keep_what_they_share_with_the_attitude(old, steered):
    new = picked(old, PLACE)
    after = changed(old, steered).gaussian
    staying = np.flatnonzero(STAYING)
    here, there = carrier_states(new, staying).ravel(), carrier_states(old, PLACE[staying]).ravel()
    np.testing.assert_array_equal(after.mean[here], steered.gaussian.mean[there])
    np.testing.assert_array_equal(
        after.covariance[ATTITUDE][:, here], steered.gaussian.covariance[ATTITUDE][:, there], strict=True
    )
    np.testing.assert_array_equal(
        after.covariance[np.ix_(here, here)], steered.gaussian.covariance[np.ix_(there, there)]
    )
    np.testing.assert_array_equal(after.mean[:12], steered.gaussian.mean[:12])  # 11 of the core and one common part
    assert (np.linalg.eigvalsh(after.covariance) > 0.0).all()


def test_new_carriers_begin_with_the_sigma_they_are_given(old, steered):
    new = picked(old, PLACE)
    after = changed(old, steered).gaussian
    positions = carrier_states(new, np.flatnonzero(~STAYING))
    np.testing.assert_array_equal(after.mean[positions], 0.0)
    np.testing.assert_array_equal(after.covariance[positions[-1], positions[-1]], 0.5**2)
    assert np.count_nonzero(after.covariance[positions[-1, 0]]) == 1


def test_a_reference_that_moved_leaves_the_innovations_as_they_are(old, steered):
    new = picked(old, PLACE)
    row = np.random.default_rng(5).normal(0.0, 0.1, new.carriers)
    epoch_us = steered.epoch_us + MINUTE_US
    plain = step(new, SETTINGS, changed(old, steered), epoch_us, row, no_motion())
    moved = step(new, SETTINGS, changed(old, steered, reference_db=0.7), epoch_us, row + 0.7, no_motion())
    # the same numbers up to rounding of levels of some dB
    np.testing.assert_allclose(moved.innovation_db, plain.innovation_db, atol=1e-12)
    np.testing.assert_allclose(moved.state.carriers.residuals_db, plain.state.carriers.residuals_db + 0.7, atol=1e-12)


def test_unknown_carriers_show_their_level_first(old, steered):
    new = picked(old, PLACE)
    after = changed(old, steered, is_unknown=~STAYING)
    positions = carrier_states(new, np.flatnonzero(~STAYING))
    np.testing.assert_array_equal(after.gaussian.covariance[positions[-1], positions[-1]], FREE_REFERENCE_DB2)
    rng, level_db = np.random.default_rng(9), np.where(STAYING, 0.0, 4.0)
    level_db[5] = 2.0  # carrier 5 of the old plan, which had stepped before
    reported = driven(new, after, 10, rng, level_db)
    assert not np.isin(reported.used, np.flatnonzero(~STAYING)).any()
    reported = driven(new, reported.state, 40, rng, level_db)
    assert len(reported.used) == new.carriers
    assert reported.state.carriers.is_relearned[~STAYING].all()
    assert (np.abs(reported.attitude_deg) < 4.0 * np.sqrt(np.diagonal(reported.covariance_deg2))).all()


def test_a_staying_carrier_whose_level_is_void_begins_anew(old, steered):
    unknown = np.arange(len(PLACE)) == 2
    after = changed(old, steered, is_unknown=unknown)
    positions = carrier_states(picked(old, PLACE), np.array([2]))[:, 0]
    np.testing.assert_array_equal(after.gaussian.mean[positions], 0.0)
    assert after.carriers.is_flagged[2]


def test_another_ladder_of_correlation_times_begins_at_its_stationary_noise(old, steered):
    new = filter_models.carrier_model(common=2, components=3)
    everyone = np.arange(old.carriers)
    none = np.zeros(old.carriers)
    after = carry_over(old, new, steered, everyone, none, none, none > 0.0).gaussian
    here, there = carrier_states(new, everyone), carrier_states(old, everyone)
    np.testing.assert_array_equal(after.mean[here[:-1]], 0.0)
    np.testing.assert_array_equal(np.diagonal(after.covariance)[here[:-1]], new.coloured_sigma_db.T**2)
    np.testing.assert_array_equal(after.mean[here[-1]], steered.gaussian.mean[there[-1]])
    np.testing.assert_array_equal(np.diagonal(after.covariance)[11:13], new.common_sigma_db**2)


def test_doubts_about_commands_stay_and_their_sums_begin_anew(old, steered):
    steered = steered._replace(
        command=steered.command._replace(share=-1.0, minutes_left=20.0, sensitivity=np.ones((60, 2)))
    )
    after = changed(old, steered).command
    assert (after.share, after.minutes_left) == (-1.0, 20.0)
    assert after.sensitivity.size == 0
    assert not after.information.any()
