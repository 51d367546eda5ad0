"""The anchor: the mixture over what may be wrong with carriers, protection levels, and a start from the references."""

from itertools import product

import filter_models
import numpy as np
import pytest
from filter_models import reference_states
from mixture_models import CALM, PRIOR, STORM, branches, jacobian

import service.core.estimation.filtering.anchor as module
from service.core.compiled_entry import CompiledEntry
from service.core.estimation.filtering import carrier_watch, motion_watch, prediction
from service.core.estimation.filtering.anchor import (
    DRY,
    ERROR_SIGMA_DEG,
    HYPOTHESES,
    RISK,
    Branches,
    Mixture,
    ask_anchor,
    is_contradicted,
    is_question_due,
    mixture_error_deg,
    protection_levels_deg,
    push_anchor,
    solve_mixture,
    start_again,
)
from service.core.estimation.filtering.filter_model import ATTITUDE, DRIFT, Gaussian
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.integrity import assess
from service.core.estimation.filtering.plant import filter_model
from service.core.estimation.filtering.row_block import empty_result

MINUTE_US = filter_models.MINUTE_US
NAMES = tuple(HYPOTHESES)


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=12)


def begun(model, epoch_us=0):
    return start(model, epoch_us, filter_models.aligned(model))


def run(model, minutes, error_deg=(0.0, 0.0, 0.0), *, state=None, noise_db=0.1, loss_db=0.0, reported=np.nan):
    """Return the state and the answers of some minutes in which the attitude of the filter has an error."""
    rng, compiled = np.random.default_rng(3), filter_model(model)
    state = begun(model) if state is None else filter_models.copied(state)
    reported_wet, answers = np.full(12, reported), []
    for minute in range(1, minutes + 1):
        residual_db = model.gradient_db_deg @ error_deg + rng.normal(0.0, noise_db, 12) - loss_db
        state.watch["epoch_us"] = minute * MINUTE_US
        push_anchor(state, residual_db, np.full(12, noise_db**2))
        answers.append(ask_anchor(compiled, state, reported_wet) if is_question_due(state) else None)
    return state, answers


def level_deg(state):
    return state.watch["level_deg"][0]


@pytest.fixture(scope="module")
def calm():
    """State and answers of twenty minutes in which nothing is wrong; `run` changes a copy."""
    return run(filter_models.carrier_model(carriers=12), 20)


def error_deg(found):
    return mixture_error_deg(found)[0]


def test_they_are_asked_every_minute_at_first_and_every_ten_minutes_then(model):
    _, answers = run(model, 60)
    assert [minute for minute, answer in enumerate(answers, 1) if answer] == [*range(1, 21), 30, 40, 50, 60]


def test_more_minutes_make_a_lower_level(model, calm):
    first, last = run(model, 1)[0], calm[0]
    assert (level_deg(last) < level_deg(first)).all()
    assert level_deg(last)[1] < 0.15


def test_an_error_of_the_attitude_contradicts(model, calm):
    _, answers = run(model, 20, (0.0, 0.15, 0.0))
    assert is_contradicted(answers[-1])
    np.testing.assert_allclose(error_deg(answers[-1])[1:], [0.15, 0.0], atol=0.04)
    assert not is_contradicted(calm[1][-1])


@pytest.mark.parametrize("error_deg", [(0.5, 0.0, 0.0), (0.0, 0.03, 0.0), (0.0, 0.0, -0.04)])
def test_yaw_alone_and_small_errors_are_left_to_the_filter(error_deg):
    assert not is_contradicted(Mixture(np.ones(1), np.array([error_deg]), np.full((1, 3, 3), 1e-6), np.ones((1, 1))))


def test_a_reference_that_is_not_known_tells_nothing(model, calm):
    known = np.where(np.arange(12) < 8, np.nan, 0.0)
    few, _ = run(model, 20, state=begun(model).with_carriers(aligned_reference_db=known))
    assert (level_deg(few) > level_deg(calm[0])).all()


def levels_now_deg(model, state, epoch_us, sigma_deg):
    """Return level and nominal level (2, 3) that are told at an epoch by some sigma of the attitude."""
    later, found = filter_models.copied(state).with_watch(epoch_us=epoch_us), empty_result(1, 12).rows[0]
    later.covariance[ATTITUDE, ATTITUDE] = np.diag(np.square(sigma_deg))
    assess(filter_model(model), later, 12, found)
    return np.array([found["protection_deg"], found["nominal_deg"]])


def test_the_level_grows_with_sigma_and_ends_after_half_an_hour(model, calm):
    state, _ = calm
    sigma, now = state.gaussian.attitude_sigma_deg, 20 * MINUTE_US
    both = np.array([state.watch["level_deg"][0], state.watch["nominal_deg"][0]])
    np.testing.assert_array_equal(levels_now_deg(model, state, now, 0.5 * sigma), both)
    np.testing.assert_allclose(levels_now_deg(model, state, now, sigma + 0.01), both + 0.04)
    # with every carrier dry little is left of the hypotheses but their priors
    assert ((both[1] < both[0]) & (both[0] < 3.0 * both[1])).all()
    assert np.isfinite(levels_now_deg(model, state, now + 30 * MINUTE_US, sigma)).all()
    assert np.isnan(levels_now_deg(model, state, now + 30 * MINUTE_US + 1, sigma)).all()
    assert np.isnan(levels_now_deg(model, begun(model), MINUTE_US, sigma)).all()


def test_noise_of_rows_that_is_declared_raises_the_level(model, calm):
    noisy, answers = run(model, 20, noise_db=2.0)
    assert not is_contradicted(answers[-1])
    assert (level_deg(noisy)[1:] > 1.5 * level_deg(calm[0])[1:]).all()


@pytest.mark.slow
def test_each_carrier_has_its_likeliest_hypothesis_and_since_when(model):
    assert np.isnan(begun(model).carriers["probability"]).all()
    dry, _ = run(model, 30)
    loss_db = np.where(np.arange(12) == 5, 0.8, 0.0)
    wet, _ = run(model, 60, state=dry.with_watch(anchor_minutes=0), loss_db=loss_db)
    before, after = dry.carriers, wet.carriers
    assert {NAMES[k] for k in before["hypothesis"]} == {"dry"}
    assert [k for k in range(12) if NAMES[after["hypothesis"][k]] != "dry"] == [5]
    assert NAMES[after["hypothesis"][5]] == "wet"
    assert 0.5 < after["probability"][5] <= 1.0
    assert 0 < after["hypothesis_since_us"][5] < 30 * MINUTE_US
    assert after["hypothesis_since_us"][0] == before["hypothesis_since_us"][0] == 0


@pytest.mark.slow
def test_reports_of_the_weather_make_wet_likelier_or_less_likely(model):
    loss_db = np.where(np.arange(12) == 5, 0.3, 0.0)

    def dry_probability(reported):
        answers = run(model, 20, loss_db=loss_db, reported=reported)[1]
        return answers[-1].branch_probability[5, 0]

    assert dry_probability(1.0) < dry_probability(np.nan) < dry_probability(0.0)


def test_reports_of_rain_that_is_none_raise_the_level_and_turn_nothing(model, calm):
    told, answers = run(model, 20, reported=1.0)
    assert not is_contradicted(answers[-1])
    assert (level_deg(told) > level_deg(calm[0])).all()


def test_old_references_are_less_sure(model, calm):
    old, _ = run(model, 20, state=begun(model, -90 * 86_400_000_000))
    assert (level_deg(old) > level_deg(calm[0])).all()


def by_hand(design, residual_db, hypotheses):
    """Return probabilities (R B^N,) and errors (R B^N, 3) of every combination, by least squares of each."""
    carriers, count = hypotheses.mean_db.shape
    weights, errors = [], []
    for regime, *chosen in product(range(2), *[range(count)] * carriers):
        at = np.arange(carriers), np.array(chosen)
        rest = residual_db - hypotheses.mean_db[at]
        covariance = design @ np.diag(PRIOR**2) @ design.T + np.diag(hypotheses.variance_db2[at])
        prior = hypotheses.regime_log_probability[regime] + hypotheses.log_probability[regime][at].sum()
        likelihood = -0.5 * (np.linalg.slogdet(covariance)[1] + rest @ np.linalg.solve(covariance, rest))
        weights.append(prior + likelihood)
        errors.append((np.diag(PRIOR**2) @ design.T @ np.linalg.solve(covariance, rest))[:3])
    weight = np.exp(np.array(weights) - max(weights))
    return weight / weight.sum(), np.array(errors)


def test_all_combinations_kept_are_those_of_least_squares(monkeypatch):
    monkeypatch.setattr(module, "KEPT", 10_000)
    rng = np.random.default_rng(5)
    design, residual_db = jacobian(rng, 4), np.array([0.1, -0.5, 0.05, -0.9])
    found = solve_mixture(design, residual_db, branches(4), PRIOR)
    probability, error = by_hand(design, residual_db, branches(4))
    assert len(found.probability) == len(probability) == 2 * 5**4
    np.testing.assert_allclose(error_deg(found), probability @ error, atol=1e-12)
    np.testing.assert_allclose(np.sort(found.probability), np.sort(probability), atol=1e-12)


def test_what_is_merged_loses_no_probability_and_hardly_moves_the_answer():
    rng = np.random.default_rng(6)
    design, residual_db = jacobian(rng, 4), np.array([0.1, -0.5, 0.05, -0.9])
    found = solve_mixture(design, residual_db, branches(4), PRIOR)
    probability, error = by_hand(design, residual_db, branches(4))
    assert len(found.probability) == module.KEPT
    assert found.probability.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(found.branch_probability.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(error_deg(found), probability @ error, atol=0.005)


def test_stations_in_rain_do_not_turn_the_spacecraft():
    rng = np.random.default_rng(7)
    design, residual_db = jacobian(rng, 16), rng.normal(0.0, 0.06, 16)
    residual_db[[2, 5, 8, 11, 14]] -= [0.5, 1.2, 0.4, 2.0, 0.8]
    found = solve_mixture(design, residual_db, branches(16), PRIOR)
    # least squares of all carriers would be wrong by more than that
    plain = np.linalg.lstsq(design, residual_db, rcond=None)[0]
    assert np.abs(plain[1:3]).max() > 0.1
    assert np.abs(error_deg(found)[1:]).max() < 0.05
    assert (found.branch_probability[[2, 5, 8, 11, 14], DRY] < 0.1).all()


def test_an_error_of_the_attitude_is_found_through_the_rain():
    rng = np.random.default_rng(8)
    design = jacobian(rng, 16)
    residual_db = design @ [0.0, 0.2, -0.15, 0.1] + rng.normal(0.0, 0.06, 16)
    residual_db[[1, 4, 9]] -= [0.9, 1.5, 0.6]
    found = solve_mixture(design, residual_db, branches(16), PRIOR)
    np.testing.assert_allclose(error_deg(found)[1:], [0.2, -0.15], atol=0.06)
    assert (np.abs(error_deg(found)[1:] - [0.2, -0.15]) < 4.0 * mixture_error_deg(found)[1][1:]).all()


def test_a_carrier_without_a_reading_tells_nothing_and_is_told_nothing():
    rng = np.random.default_rng(9)
    design, residual_db = jacobian(rng, 8), rng.normal(0.0, 0.06, 8)
    residual_db[3] = np.nan
    found = solve_mixture(design, residual_db, branches(8), PRIOR)
    kept = np.arange(8) != 3
    seven = branches(8)
    seven = Branches(seven.mean_db[kept], seven.variance_db2[kept], seven.log_probability[:, kept], np.log([0.8, 0.2]))
    np.testing.assert_allclose(
        error_deg(found), error_deg(solve_mixture(design[kept], residual_db[kept], seven, PRIOR)), atol=1e-12
    )
    share = found.branch_probability[3, DRY]
    assert CALM[DRY] > share > STORM[DRY]


def test_without_readings_the_error_is_what_it_was_before():
    found = solve_mixture(np.ones((3, 4)), np.full(3, np.nan), branches(3), PRIOR)
    np.testing.assert_allclose(mixture_error_deg(found)[1], PRIOR[:3])
    np.testing.assert_array_equal(error_deg(found), 0.0)


SIGMA_DEG = np.array([0.2, 0.02, 0.03])


def levels_deg(mixture, risk=RISK):
    return protection_levels_deg(mixture, np.zeros(3), risk)


def one(mean_deg=(0.0, 0.0, 0.0), sigma_deg=SIGMA_DEG):
    return Mixture(np.ones(1), np.array([mean_deg]), np.diag(np.square(sigma_deg))[None], np.ones((1, 1)))


def test_one_normal_error_has_the_quantile_of_the_normal_distribution():
    # two-sided: 1e-4 lies beyond 3.891 sigma
    np.testing.assert_allclose(levels_deg(one()), 3.8906 * SIGMA_DEG, rtol=1e-3)


def test_an_expected_error_is_added():
    # one-sided now: 1e-4 lies beyond 3.719 sigma
    levels = levels_deg(one((0.0, 0.3, -0.3)))
    np.testing.assert_allclose(levels[1:], 0.3 + 3.719 * SIGMA_DEG[1:], rtol=1e-3)


def test_an_unlikely_combination_counts_once_it_is_likelier_than_the_risk():
    def levels(probability):
        return levels_deg(
            Mixture(
                np.array([1.0 - probability, probability]),
                np.array([[0.0, 0.0, 0.0], [0.0, 0.5, 0.0]]),
                np.tile(np.diag(np.square(SIGMA_DEG)), (2, 1, 1)),
                np.ones((1, 1)),
            )
        )

    assert levels(1e-5)[1] < 0.09
    assert 0.5 < levels(1e-3)[1] < 0.53
    assert levels(1e-3)[2] == pytest.approx(levels(1e-5)[2], rel=0.01)


#: six hundred mixtures take 25 s of plain Python, a third of it with the compiler's time
MODULES = (prediction, motion_watch, carrier_watch, module)
COMPILED_MIXTURE, COMPILED_LEVELS = (CompiledEntry(each, MODULES) for each in (solve_mixture, protection_levels_deg))


@pytest.mark.slow
def test_errors_of_the_assumed_kind_pass_the_level_as_often_as_it_says():
    """Truth is drawn from the hypotheses themselves; a risk of 2 % is seen in 600 draws."""
    rng = np.random.default_rng(31)
    passed, draws, risk = np.zeros(3), 600, 0.02
    for _ in range(draws):
        known, design = branches(12), jacobian(rng, 12)
        regime = int(rng.random() < 0.2)
        chosen = [rng.choice(5, p=np.exp(known.log_probability[regime, k])) for k in range(12)]
        at = np.arange(12), np.array(chosen)
        truth = rng.normal(0.0, PRIOR)
        residual_db = design @ truth + known.mean_db[at] + np.sqrt(known.variance_db2[at]) * rng.normal(size=12)
        level = COMPILED_LEVELS(COMPILED_MIXTURE(design, residual_db, known, PRIOR), np.zeros(3), risk)
        passed += np.abs(truth[:3]) > level
    # two standard deviations of a share of 2 % in 600 draws are 1.1 %
    assert (passed / draws < risk + 0.012).all()
    # a level that nothing ever passes says nothing
    assert passed.sum() > 0


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
    return state.with_carriers(is_flagged=np.arange(FEW) == 1, is_relearned=np.isin(np.arange(FEW), [0, 2, 3]))


def mixture(likeliest=("dry", "dry", "learned", "rain", "dry", "dry")):
    place = {"dry": 0, "rain": 2, "changed": 3, "learned": 4}
    told = np.full((FEW, 5), 0.025)
    told[np.arange(FEW), [place[each] for each in likeliest]] = 0.9
    return Mixture(np.ones(1), ERROR_DEG[None], np.diag([0.01, 0.0004, 0.0009])[None], told)


def started_again(model, state):
    after = filter_models.copied(state)
    start_again(filter_model(model), after, mixture())
    return after


def test_the_attitude_moves_by_the_error_and_is_free(few, state):
    after = started_again(few, state).gaussian
    np.testing.assert_allclose(after.mean[ATTITUDE], state.mean[ATTITUDE] + ERROR_DEG)
    sigma_deg = np.hypot(ERROR_SIGMA_DEG, state.gaussian.attitude_sigma_deg)
    np.testing.assert_allclose(after.covariance[ATTITUDE, ATTITUDE], np.diag(sigma_deg**2))
    assert not after.covariance[ATTITUDE, 3:].any()
    np.testing.assert_array_equal(after.mean[DRIFT], state.mean[DRIFT])


def test_dry_carriers_have_the_reference_of_the_alignment_again(few, state):
    after = started_again(few, state)
    positions = reference_states(few, np.array([0, 1, 4]))
    np.testing.assert_array_equal(after.mean[positions], 0.0)
    assert not after.carriers["is_flagged"][[0, 1, 4]].any()
    assert not after.carriers["is_relearned"][[0, 1, 4]].any()


def test_wet_carriers_are_set_aside_and_learned_levels_stay(few, state):
    after = started_again(few, state)
    assert np.flatnonzero(after.carriers["is_flagged"]).tolist() == [3]
    # it comes back to the level of the alignment, not to the one that rain taught
    assert after.carriers["saved_reference_db"][3] == 0.0
    assert after.mean[reference_states(few, np.array([2]))] == 1.5


def test_a_carrier_without_a_reference_of_the_alignment_is_never_given_one(few, state):
    known = np.where(np.arange(FEW) == 4, np.nan, 0.0)
    unknown = state.with_carriers(aligned_reference_db=known)
    after = started_again(few, unknown)
    assert after.carriers["is_flagged"][4]
    assert np.isfinite(after.mean).all()


def test_the_level_is_that_of_the_moved_attitude(few, state):
    after = started_again(few, state)
    # 3.891 sigma of an error that is expected to be zero now
    np.testing.assert_allclose(level_deg(after), 3.8906 * np.array([0.1, 0.02, 0.03]), rtol=1e-3)
