"""Claims about the choice between the causes that move several carriers at once."""

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.causes.fault_hypotheses import Cause, choose_cause
from service.core.estimation.filtering.filter_update import innovate
from service.core.estimation.filtering.model.filter_model import pattern_change

CARRIERS = 16
EVERYONE = np.arange(CARRIERS)


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=CARRIERS, groups=3)


def chosen(filter_models, model, change_db, seed, carriers=EVERYONE):
    noise_db = 0.17 * np.random.default_rng(seed).standard_normal(CARRIERS)
    state = filter_models.aligned(model)
    return choose_cause(model, innovate(model, state, change_db + noise_db, carriers, model.white_sigma_db**2))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("size_db", [-2.0, 0.8])
def test_a_transponders_step_is_its_group(model, seed, size_db):
    change_db = np.where(model.transponder == 1, size_db, 0.0)
    choice = chosen(filter_models, model, change_db, seed)
    assert (choice.cause, choice.transponder) == (Cause.GROUP, 1)


@pytest.mark.parametrize("seed", range(5))
def test_a_step_of_all_is_common(model, seed):
    assert chosen(filter_models, model, np.full(CARRIERS, -1.5), seed).cause is Cause.COMMON


@pytest.mark.parametrize("seed", range(5))
def test_a_turn_is_an_attitude_jump(model, seed):
    change_db = pattern_change(model, np.array([0.0, 0.4, -0.5])).deviation_db
    assert chosen(filter_models, model, change_db, seed).cause is Cause.ATTITUDE


@pytest.mark.parametrize("seed", range(5))
def test_single_faults_stay_single(model, seed):
    change_db = np.zeros(CARRIERS)
    change_db[[0, 1, 2, 5]] = [-3.0, 2.0, -1.5, -4.0]
    assert chosen(filter_models, model, change_db, seed).cause is Cause.INDEPENDENT


def test_a_group_with_a_fault_elsewhere_is_still_a_group(model):
    change_db = np.where(model.transponder == 2, 1.5, 0.0)
    change_db[0] = -5.0
    assert chosen(filter_models, model, change_db, 1).cause is Cause.GROUP


def test_too_few_carriers_of_a_transponder_are_no_group(model):
    carriers = np.array([0, 1, 3, 4, 6, 7, 9, 10])  # none of transponder 2, four each of 0 and 1
    change_db = np.where(model.transponder == 1, 2.0, 0.0)
    assert chosen(filter_models, model, change_db, 1, carriers).transponder == 1
    pairs = np.array([0, 1, 3, 4, 6, 9])  # two of transponder 1
    assert chosen(filter_models, model, change_db, 1, pairs).transponder != 1
