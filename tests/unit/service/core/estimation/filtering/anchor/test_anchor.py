"""Anchor of the filter: the watch, the mixture of carriers and protection."""

from itertools import product

import filter_models
import numpy as np
import pytest
from mixture_models import CALM, PRIOR, STORM, branches, jacobian

import service.core.estimation.filtering.anchor as module
from service.core.estimation.filtering.anchor import (
    ask_anchor,
    calm_anchor,
    carrier_hypotheses,
    is_contradicted,
    is_question_due,
    protection_levels_deg,
    protection_now_deg,
    push_residuals,
)
from service.core.estimation.filtering.anchor import DRY, Branches, Mixture, solve_mixture
from service.core.estimation.filtering.carrier_watch import healthy
from service.core.estimation.filtering.filter_model import ATTITUDE
from service.core.estimation.filtering.rows.row_kernels import compiled_kernels

MINUTE_US = filter_models.MINUTE_US


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=12)


def run(
    model, minutes, error_deg=(0.0, 0.0, 0.0), *, watch=None, change=None, noise_db=0.1, loss_db=0.0, reported=None
):
    """Return the watch and the answers of some minutes in which the attitude of the filter has an error."""
    rng, state = np.random.default_rng(3), filter_models.aligned(model)
    watch = calm_anchor(12, 0) if watch is None else watch
    carriers = healthy(np.full(12, 0.03**2))
    carriers = carriers if change is None else change(carriers)
    answers = []
    for minute in range(1, minutes + 1):
        residual_db = model.gradient_db_deg @ error_deg + rng.normal(0.0, noise_db, 12) - loss_db
        watch, answer = push_residuals(watch, residual_db, np.full(12, noise_db**2)), None
        if is_question_due(watch, minute * MINUTE_US):
            watch, answer = ask_anchor(
                model, watch, carriers, state, minute * MINUTE_US, is_raining=False, reported_wet=reported
            )
        answers.append(answer)
    return watch, answers


def test_they_are_asked_every_minute_at_first_and_every_ten_minutes_then(model):
    _, answers = run(model, 60)
    assert [minute for minute, answer in enumerate(answers, 1) if answer] == [*range(1, 21), 30, 40, 50, 60]


def test_more_minutes_make_a_lower_level(model):
    first, _ = run(model, 1)
    last, _ = run(model, 20)
    assert (last.level_deg < first.level_deg).all()
    assert last.level_deg[1] < 0.15


def test_an_error_of_the_attitude_contradicts(model):
    _, answers = run(model, 20, (0.0, 0.15, 0.0))
    assert is_contradicted(answers[-1])
    np.testing.assert_allclose(answers[-1].error_deg[1:], [0.15, 0.0], atol=0.04)
    assert not is_contradicted(run(model, 20)[1][-1])


@pytest.mark.parametrize("error_deg", [(0.5, 0.0, 0.0), (0.0, 0.03, 0.0), (0.0, 0.0, -0.04)])
def test_yaw_alone_and_small_errors_are_left_to_the_filter(error_deg):
    assert not is_contradicted(Mixture(np.ones(1), np.array([error_deg]), np.full((1, 3, 3), 1e-6), np.ones((1, 1))))


def test_a_reference_that_is_not_known_tells_nothing(model):
    def without(carriers):
        known = carriers.aligned_reference_db.copy()
        known[:8] = np.nan
        return carriers._replace(aligned_reference_db=known)

    few, _ = run(model, 20, change=without)
    all_of_them, _ = run(model, 20)
    assert (few.level_deg > all_of_them.level_deg).all()


def test_the_level_grows_with_sigma_and_ends_after_half_an_hour(model):
    watch, _ = run(model, 20)
    sigma = filter_models.aligned(model).attitude_sigma_deg
    now = 20 * MINUTE_US
    both = np.array([watch.level_deg, watch.nominal_deg])
    np.testing.assert_array_equal(protection_now_deg(watch, now, 0.5 * sigma), both)
    np.testing.assert_allclose(protection_now_deg(watch, now, sigma + 0.01), both + 0.04)
    # with every carrier dry little is left of the hypotheses but their priors
    assert ((both[1] < both[0]) & (both[0] < 3.0 * both[1])).all()
    assert np.isfinite(protection_now_deg(watch, now + 30 * MINUTE_US, sigma)).all()
    assert np.isnan(protection_now_deg(watch, now + 30 * MINUTE_US + 1, sigma)).all()
    assert np.isnan(protection_now_deg(calm_anchor(12, 0), MINUTE_US, sigma)).all()


def test_noise_of_rows_that_is_declared_raises_the_level(model):
    _, answers = run(model, 20, noise_db=2.0)
    assert not is_contradicted(answers[-1])
    assert (run(model, 20, noise_db=2.0)[0].level_deg[1:] > 1.5 * run(model, 20)[0].level_deg[1:]).all()


def test_each_carrier_has_its_likeliest_hypothesis_and_since_when(model):
    assert {each.name for each in carrier_hypotheses(calm_anchor(12, 0))} == {None}
    dry, _ = run(model, 30)
    wet, _ = run(model, 60, watch=dry._replace(minutes=0), loss_db=np.where(np.arange(12) == 5, 0.8, 0.0))
    before, after = carrier_hypotheses(dry), carrier_hypotheses(wet)
    assert {each.name for each in before} == {"dry"}
    assert [k for k, each in enumerate(after) if each.name != "dry"] == [5]
    assert after[5].name == "wet"
    assert 0.5 < after[5].probability <= 1.0
    assert 0 < after[5].since_us < 30 * MINUTE_US
    assert after[0].since_us == before[0].since_us == 0


def test_reports_of_the_weather_make_wet_likelier_or_less_likely(model):
    loss_db = np.where(np.arange(12) == 5, 0.3, 0.0)

    def dry_probability(reported):
        answers = run(model, 20, loss_db=loss_db, reported=reported)[1]
        return answers[-1].branch_probability[5, 0]

    nobody = dry_probability(None)
    assert dry_probability(np.full(12, np.nan)) == nobody
    assert dry_probability(np.ones(12)) < nobody < dry_probability(np.zeros(12))


def test_reports_of_rain_that_is_none_raise_the_level_and_turn_nothing(model):
    told, answers = run(model, 20, reported=np.ones(12))
    assert not is_contradicted(answers[-1])
    assert (told.level_deg > run(model, 20)[0].level_deg).all()


def test_old_references_are_less_sure(model):
    young, _ = run(model, 20)
    old, _ = run(model, 20, watch=calm_anchor(12, -90 * 86_400_000_000))
    assert (old.level_deg[ATTITUDE] > young.level_deg).all()


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
    np.testing.assert_allclose(found.error_deg, probability @ error, atol=1e-12)
    np.testing.assert_allclose(np.sort(found.probability), np.sort(probability), atol=1e-12)


def test_what_is_merged_loses_no_probability_and_hardly_moves_the_answer():
    rng = np.random.default_rng(6)
    design, residual_db = jacobian(rng, 4), np.array([0.1, -0.5, 0.05, -0.9])
    found = solve_mixture(design, residual_db, branches(4), PRIOR)
    probability, error = by_hand(design, residual_db, branches(4))
    assert len(found.probability) == module.KEPT
    assert found.probability.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(found.branch_probability.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(found.error_deg, probability @ error, atol=0.005)


def test_stations_in_rain_do_not_turn_the_spacecraft():
    rng = np.random.default_rng(7)
    design, residual_db = jacobian(rng, 16), rng.normal(0.0, 0.06, 16)
    residual_db[[2, 5, 8, 11, 14]] -= [0.5, 1.2, 0.4, 2.0, 0.8]
    found = solve_mixture(design, residual_db, branches(16), PRIOR)
    # least squares of all carriers would be wrong by more than that
    plain = np.linalg.lstsq(design, residual_db, rcond=None)[0]
    assert np.abs(plain[1:3]).max() > 0.1
    assert np.abs(found.error_deg[1:]).max() < 0.05
    assert (found.branch_probability[[2, 5, 8, 11, 14], DRY] < 0.1).all()


def test_an_error_of_the_attitude_is_found_through_the_rain():
    rng = np.random.default_rng(8)
    design = jacobian(rng, 16)
    residual_db = design @ [0.0, 0.2, -0.15, 0.1] + rng.normal(0.0, 0.06, 16)
    residual_db[[1, 4, 9]] -= [0.9, 1.5, 0.6]
    found = solve_mixture(design, residual_db, branches(16), PRIOR)
    np.testing.assert_allclose(found.error_deg[1:], [0.2, -0.15], atol=0.06)
    assert (np.abs(found.error_deg[1:] - [0.2, -0.15]) < 4.0 * found.sigma_deg[1:]).all()


def test_a_carrier_without_a_reading_tells_nothing_and_is_told_nothing():
    rng = np.random.default_rng(9)
    design, residual_db = jacobian(rng, 8), rng.normal(0.0, 0.06, 8)
    residual_db[3] = np.nan
    found = solve_mixture(design, residual_db, branches(8), PRIOR)
    kept = np.arange(8) != 3
    seven = branches(8)
    seven = Branches(seven.mean_db[kept], seven.variance_db2[kept], seven.log_probability[:, kept], np.log([0.8, 0.2]))
    np.testing.assert_allclose(
        found.error_deg, solve_mixture(design[kept], residual_db[kept], seven, PRIOR).error_deg, atol=1e-12
    )
    share = found.branch_probability[3, DRY]
    assert CALM[DRY] > share > STORM[DRY]


def test_without_readings_the_error_is_what_it_was_before():
    found = solve_mixture(np.ones((3, 4)), np.full(3, np.nan), branches(3), PRIOR)
    np.testing.assert_allclose(found.sigma_deg, PRIOR[:3])
    np.testing.assert_array_equal(found.error_deg, 0.0)


@pytest.mark.parametrize("carriers", [1, 4, 16])
def test_compiled_the_same_source_gives_the_same_mixture_and_levels(carriers):
    rng, compiled = np.random.default_rng(10), compiled_kernels().anchor
    design, residual_db = jacobian(rng, carriers), rng.normal(0.0, 0.4, carriers)
    plain = solve_mixture(design, residual_db, branches(carriers), PRIOR)
    first, second = (solve_mixture(design, residual_db, branches(carriers), PRIOR, compiled) for _ in range(2))
    for one, other, again in zip(plain, first, second, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12)  # products of another library add in another order
        np.testing.assert_array_equal(other, again)
    np.testing.assert_allclose(
        protection_levels_deg(plain), protection_levels_deg(first, kernels=compiled), rtol=0.0, atol=1e-5
    )  # found to 3e-6 deg


SIGMA_DEG = np.array([0.2, 0.02, 0.03])


def one(mean_deg=(0.0, 0.0, 0.0), sigma_deg=SIGMA_DEG):
    return Mixture(np.ones(1), np.array([mean_deg]), np.diag(np.square(sigma_deg))[None], np.ones((1, 1)))


def test_one_normal_error_has_the_quantile_of_the_normal_distribution():
    # two-sided: 1e-4 lies beyond 3.891 sigma
    np.testing.assert_allclose(protection_levels_deg(one()), 3.8906 * SIGMA_DEG, rtol=1e-3)


def test_an_expected_error_is_added():
    # one-sided now: 1e-4 lies beyond 3.719 sigma
    levels = protection_levels_deg(one((0.0, 0.3, -0.3)))
    np.testing.assert_allclose(levels[1:], 0.3 + 3.719 * SIGMA_DEG[1:], rtol=1e-3)


def test_an_unlikely_combination_counts_once_it_is_likelier_than_the_risk():
    def levels(probability):
        return protection_levels_deg(
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
        level = protection_levels_deg(solve_mixture(design, residual_db, known, PRIOR), risk)
        passed += np.abs(truth[:3]) > level
    # two standard deviations of a share of 2 % in 600 draws are 1.1 %
    assert (passed / draws < risk + 0.012).all()
    # a level that nothing ever passes says nothing
    assert passed.sum() > 0
