"""Transponders under level control: who belongs to a group, and what is taken out of it."""

import numpy as np
import pytest
from geometry_payload import GeometryPayload, replace

from service.pipeline.carrier_model.level_control import alc_groups, first_model_dbm, small_groups, without_group_means
from service.records.catalogue import CarrierPlan

GROUP = np.array([-1, 0, 0, 0, 1, 1, 1, 1])


def test_groups_are_transponders_under_level_control():
    carriers = list(GeometryPayload.make(8).carriers)
    assert alc_groups(CarrierPlan(1, "x", tuple(carriers))).tolist() == [-1] * 8
    for k in (4, 5, 6, 7):
        carriers[k] = replace(carriers[k], transponder_mode="alc")
    carriers[0] = replace(carriers[0], transponder_mode="alc")
    group = alc_groups(CarrierPlan(1, "x", tuple(carriers)))
    assert group.tolist() == [0, -1, -1, -1, 1, 1, 1, 1]
    assert small_groups(group).tolist() == [True] + [False] * 7


def test_what_a_group_does_together_goes_and_the_rest_stays():
    rng = np.random.default_rng(1)
    model, own = rng.uniform(-45.0, -40.0, 8), rng.normal(size=(50, 8))
    gain = rng.normal(size=(50, 2))
    power = model + own + np.where(GROUP < 0, 0.0, gain[:, GROUP])
    taken = without_group_means(power, model, GROUP)
    assert (taken[:, 0] == power[:, 0]).all()
    # the group's gain is gone, and with it the mean of its carriers; rounding of levels of 45 dB
    assert taken[:, 1:4] == pytest.approx(model[1:4] + own[:, 1:4] - own[:, 1:4].mean(axis=1, keepdims=True), abs=1e-12)


def test_an_absent_carrier_does_not_move_the_others_by_its_level():
    model = np.array([-40.0, -41.0, -45.0, -49.0, -40.0, -40.0, -40.0, -40.0])
    power = np.tile(model, (3, 1))
    power[1, 6] = np.nan
    taken = without_group_means(power, model, GROUP)
    assert taken[1, [4, 5, 7]] == pytest.approx(model[[4, 5, 7]], abs=1e-12)
    assert np.isnan(taken[1, 6])


def test_rows_of_two_say_nothing():
    power = np.full((2, 8), -40.0)
    power[0, 2] = np.nan
    assert np.isnan(without_group_means(power, np.full(8, -40.0), GROUP)[0, 1:4]).all()
    assert np.isfinite(without_group_means(power, np.full(8, -40.0), GROUP)[1]).all()


def test_the_first_model_is_the_median():
    power = np.array([[-40.0, np.nan], [-41.0, np.nan], [-60.0, np.nan]])
    assert first_model_dbm(power).tolist() == [-41.0, 0.0]
