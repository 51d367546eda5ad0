"""Claims about when the references of the alignment are asked, and how long their answer holds."""

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.anchor.anchor_watch import (
    ask_anchor,
    calm_anchor,
    carrier_hypotheses,
    is_contradicted,
    is_question_due,
    protection_now_deg,
    push_residuals,
)
from service.core.estimation.filtering.anchor.carrier_mixture import Mixture
from service.core.estimation.filtering.causes.carrier_faults import healthy
from service.core.estimation.filtering.model.filter_state import ATTITUDE

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
    np.testing.assert_array_equal(protection_now_deg(watch, now, 0.5 * sigma), watch.level_deg)
    np.testing.assert_allclose(protection_now_deg(watch, now, sigma + 0.01), watch.level_deg + 0.04)
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
