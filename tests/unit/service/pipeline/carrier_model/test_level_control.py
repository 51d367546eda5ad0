"""Level-controlled groups: what all members do together is taken away, and nothing else."""

import filter_models
import numpy as np

from service.core.estimation.calibration.quadratic_response import exact_response, predict_deviation
from service.pipeline.carrier_model.level_control import (
    centred_model,
    centred_response,
    member_groups,
    without_group_gain,
)

NAN = float("nan")
EVERY = np.ones(6, dtype=np.bool_)


def test_members_are_the_used_carriers_of_each_group():
    is_used = np.array([True, True, False, True, True, True])
    found = member_groups((0, -1, 0, 1, 0, 1), is_used)
    assert [members.tolist() for members in found] == [[0, 4], [3, 5]]
    assert member_groups((), EVERY) == ()
    assert member_groups((-1,) * 6, EVERY) == ()


def test_a_gain_of_the_group_changes_nothing_and_the_others_are_not_touched():
    groups = member_groups((0, 0, 0, 0, -1, -1), EVERY)
    rng = np.random.default_rng(3)
    response = exact_response(rng.normal(size=(6, 3)), np.zeros((6, 3, 3)))
    attitude = np.array([0.1, -0.2, 0.3])
    centred = predict_deviation(attitude, centred_response(response, groups))
    plain = predict_deviation(attitude, response)
    for gain_db in (0.0, 3.7):
        measured = plain + gain_db * np.array([1, 1, 1, 1, 0, 0])
        # what is explained beforehand is the centred answer, so the median finds gain and mean answer to rounding
        np.testing.assert_allclose(without_group_gain(measured, centred, groups), centred, atol=1e-12)
    np.testing.assert_array_equal(centred[4:], plain[4:])


def test_rain_on_one_member_does_not_move_the_others():
    groups = member_groups((0,) * 6, EVERY)
    rained = np.array([0.01, -0.02, 0.0, 0.02, -0.01, -5.0])
    kept = without_group_gain(rained, np.zeros(6), groups)
    # the median moves by no more than the spread of the dry ones
    np.testing.assert_allclose(kept[:5], rained[:5], atol=0.02)
    assert kept[5] < -4.9


def test_too_few_members_tell_nothing_and_absent_ones_stay_absent():
    groups = member_groups((0,) * 6, EVERY)
    rows = np.array([[1.0, 2.0, NAN, NAN, NAN, NAN], [1.0, 2.0, 3.0, NAN, NAN, NAN]])
    kept = without_group_gain(rows, np.zeros((2, 6)), groups)
    assert np.isnan(kept[0]).all()
    np.testing.assert_allclose(kept[1, :3], [-1.0, 0.0, 1.0], atol=1e-12)
    assert np.isnan(kept[1, 3:]).all()


def test_without_groups_everything_stays_what_it_is():
    model = filter_models.carrier_model()
    response = exact_response(np.ones((6, 3)), np.zeros((6, 3, 3)))
    values = np.arange(6.0)
    assert centred_model(model, ()) is model
    assert centred_response(response, ()) is response
    assert without_group_gain(values, values, ()) is values


def test_the_filter_counts_patterns_from_the_groups_mean_and_keeps_its_rain_away():
    model = filter_models.carrier_model()
    groups = member_groups((0, 0, 0, *(-1,) * 9), np.ones(12, dtype=np.bool_))
    found = centred_model(model, groups)
    np.testing.assert_allclose(found.gradient_db_deg[:3].mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(found.hessian_db_deg2[:3].mean(axis=0), 0.0, atol=1e-12)
    assert found.rain_share[:3].tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(found.gradient_db_deg[3:], model.gradient_db_deg[3:])
    np.testing.assert_array_equal(found.rain_share[3:], model.rain_share[3:])
