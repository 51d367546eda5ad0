"""Common causes of changes of several carriers: told apart, freed, left."""

import filter_models
import numpy as np
import pytest
from filter_models import reference_states

from service.core.estimation.filtering.common_cause import (
    ATTITUDE_JUMP,
    COMMON,
    GROUP,
    HOLD_MINUTES,
    INDEPENDENT,
    NOTHING,
    SLOW_CHANGE,
    SUDDEN_CHANGE,
    choose_cause,
    common_innovation,
    pass_rain,
    push_common,
    suspicion,
    widen_cause,
)
from service.core.estimation.filtering.filter_model import ATTITUDE, CHAIN, RAIN, pattern_change
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.plant import filter_model
from service.core.estimation.filtering.prediction import Innovation

CARRIERS = 16
EVERYONE = np.arange(CARRIERS)


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=CARRIERS, groups=3)


def common_of(model, innovation_db, covariance_db2):
    """Return the common value of carriers whose innovations have some covariance."""
    count = len(innovation_db)
    nothing = np.zeros((count, 0))
    found = Innovation(np.arange(count), innovation_db, covariance_db2, np.zeros(count), nothing, nothing)
    return common_innovation(filter_model(model), found)


def test_the_common_value_has_unit_variance_and_ignores_a_minority():
    fifteen = filter_models.carrier_model(carriers=20)  # five are of another band
    rng = np.random.default_rng(5)
    covariance = 0.03 * np.eye(15) + 0.004
    rows = rng.multivariate_normal(np.zeros(15), covariance, size=4000)
    values = np.array([common_of(fifteen, row, covariance)[1] for row in rows])
    # 4000 draws are good to 1.1 %; the median of 15 is a little better than pi/2 says
    assert 0.9 < values.std() < 1.03
    faded = np.zeros(15)
    faded[:6] = -20.0
    assert common_of(fifteen, faded, covariance) == (0.0, 0.0)
    assert common_of(fifteen, np.array([1.0, 2.0, 4.0, 5.0]), np.eye(4))[0] == 3.0
    assert np.isnan(common_of(fifteen, np.array([1.0, 3.0]), np.eye(2))).all()


def chosen(model, change_db, seed, carriers=EVERYONE):
    noise_db = 0.17 * np.random.default_rng(seed).standard_normal(CARRIERS)
    compiled, gaussian = filter_model(model), filter_models.aligned(model)
    innovation = filter_models.innovated(compiled, gaussian, change_db + noise_db, carriers)
    return choose_cause(compiled, innovation)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("size_db", [-2.0, 0.8])
def test_a_transponders_step_is_its_group(model, seed, size_db):
    assert chosen(model, np.where(model.transponder == 1, size_db, 0.0), seed) == (GROUP, 1)


@pytest.mark.parametrize("seed", range(5))
def test_a_step_of_all_is_common(model, seed):
    assert chosen(model, np.full(CARRIERS, -1.5), seed) == (COMMON, -1)


@pytest.mark.parametrize("seed", range(5))
def test_a_turn_is_an_attitude_jump(model, seed):
    change_db = pattern_change(model, np.array([0.0, 0.4, -0.5])).deviation_db
    assert chosen(model, change_db, seed) == (ATTITUDE_JUMP, -1)


@pytest.mark.parametrize("seed", range(5))
def test_single_faults_stay_single(model, seed):
    change_db = np.zeros(CARRIERS)
    change_db[[0, 1, 2, 5]] = [-3.0, 2.0, -1.5, -4.0]
    assert chosen(model, change_db, seed)[0] == INDEPENDENT


def test_a_group_with_a_fault_elsewhere_is_still_a_group(model):
    change_db = np.where(model.transponder == 2, 1.5, 0.0)
    change_db[0] = -5.0
    assert chosen(model, change_db, 1)[0] == GROUP


def test_too_few_carriers_of_a_transponder_are_no_group(model):
    carriers = np.array([0, 1, 3, 4, 6, 7, 9, 10])  # none of transponder 2, four each of 0 and 1
    change_db = np.where(model.transponder == 1, 2.0, 0.0)
    assert chosen(model, change_db, 1, carriers)[1] == 1
    pairs = np.array([0, 1, 3, 4, 6, 9])  # two of transponder 1
    assert chosen(model, change_db, 1, pairs)[1] != 1


@pytest.fixture
def calm():
    model = filter_models.carrier_model()
    return start(model, 0, filter_models.aligned(model))


def with_levels(state, chain_db, rain_db, **watch):
    found = filter_models.copied(state).with_watch(**watch)
    found.mean[CHAIN], found.mean[RAIN] = chain_db, rain_db
    return found


def widened(state, median_db, cause=COMMON, transponder=-1, *, is_chain_worked=False):
    after, compiled = filter_models.copied(state), filter_model(filter_models.carrier_model())
    widen_cause(compiled, after, cause, transponder, median_db, is_chain_worked)
    return after, after.watch[0]


def push(state, *values):
    for value in values:
        push_common(state, value)


def test_sums_tell_falls_from_rises(calm):
    few, before = np.zeros(12), calm.mean[CHAIN]
    assert suspicion(calm, few, 0.0) == NOTHING
    push(calm, -5.0, -6.0)
    assert suspicion(calm, few, 0.0) == SLOW_CHANGE
    assert widened(calm, 0.0)[1]["is_raining"]
    push(calm, 8.0, 9.0)
    # what fell has risen since
    assert calm.watch["common_down"][0] == 0.0
    assert widened(calm, 0.0)[1]["hold_minutes"] == HOLD_MINUTES
    assert calm.watch["base_chain_db"][0] == before


def test_several_suspects_or_a_sudden_common_value_ask_for_the_cause(calm):
    assert suspicion(calm, np.repeat([3.1, 0.0], [2, 10]), 0.0) == NOTHING
    assert suspicion(calm, np.repeat([3.1, 0.0], [3, 9]), 0.0) == SUDDEN_CHANGE
    assert suspicion(calm, np.zeros(12), -7.1) == SUDDEN_CHANGE


def test_rain_takes_back_what_the_chain_swallowed_before_the_alarm(calm):
    calm.mean[CHAIN] = 0.02
    push(calm, 0.3)
    for chain_db in (0.0, -0.1, -0.2):
        calm.mean[CHAIN] = chain_db
        push(calm, -4.0)
    after, watch = widened(with_levels(calm, -0.25, 0.0), -0.3)
    assert watch["is_raining"]
    np.testing.assert_allclose(after.mean[[CHAIN, RAIN]], [0.02, 0.27])
    np.testing.assert_allclose(after.covariance[RAIN, RAIN] - calm.covariance[RAIN, RAIN], 0.25)
    assert watch["common_down"] == 0.0


def test_a_further_fall_in_rain_only_frees_the_rain(calm):
    after, watch = widened(with_levels(calm, 0.0, 1.0, is_raining=True, wet_minutes=7.0), -3.0)
    assert after.mean[RAIN] == 1.0
    assert watch["wet_minutes"] == 7.0
    np.testing.assert_allclose(after.covariance[RAIN, RAIN], 9.0, rtol=1e-3)


def test_a_rise_frees_the_chain_and_holds_control_for_ten_minutes(calm):
    after, watch = widened(calm, 3.0)
    np.testing.assert_allclose(after.covariance[CHAIN, CHAIN] - calm.covariance[CHAIN, CHAIN], 9.0)
    assert watch["hold_minutes"] == HOLD_MINUTES
    assert not watch["is_raining"]


def test_a_fall_while_the_chain_is_worked_on_is_a_step_of_it(calm):
    after, watch = widened(calm, -3.0, is_chain_worked=True)
    np.testing.assert_allclose(after.covariance[CHAIN, CHAIN] - calm.covariance[CHAIN, CHAIN], 9.0)
    assert not watch["is_raining"]


def test_rain_that_recedes_is_no_step_of_the_chain(calm):
    after, watch = widened(with_levels(calm, 0.0, 3.0, is_raining=True), 3.0)
    assert watch["hold_minutes"] == 0.0
    assert after.covariance[RAIN, RAIN] > 8.9
    assert widened(with_levels(calm, 0.0, 0.5, is_raining=True), 3.0)[1]["hold_minutes"] == HOLD_MINUTES


def test_a_transponders_step_frees_its_references_together_but_for_the_flagged(calm):
    model = filter_models.carrier_model()
    before = calm.with_carriers(is_flagged=np.arange(12) == 4, up=3.0, down=2.0)
    after, _ = widened(before, -1.0, GROUP, 1)
    members = reference_states(model, np.array([1, 7, 10]))
    expected = np.zeros_like(calm.covariance)
    expected[np.ix_(members, members)] = 4.0
    np.testing.assert_allclose(after.covariance - calm.covariance, expected, atol=1e-12)
    # what belongs to the common cause is no single carrier's
    assert not after.carriers["up"].any()
    assert not after.carriers["down"].any()


def test_a_jump_frees_the_attitude_and_nothing_else(calm):
    after, _ = widened(calm, 0.0, ATTITUDE_JUMP)
    grown = after.covariance - calm.covariance
    np.testing.assert_allclose(grown[ATTITUDE, ATTITUDE], 0.09 * np.eye(3))
    grown[ATTITUDE, ATTITUDE] = 0.0
    assert not grown.any()


def passed(state, minutes, chain_db, rain_db):
    after = with_levels(state, chain_db, rain_db)
    pass_rain(after, minutes)
    return after


def test_rain_ends_after_eight_dry_minutes_and_leaves_the_sum_of_levels(calm):
    state = passed(passed(calm.with_watch(is_raining=True), 1.0, 0.2, 0.1), 1.0, 0.2, 0.4)
    assert state.watch["dry_minutes"][0] == 0.0
    minutes = 0
    while state.watch["is_raining"][0]:
        state = passed(state, 1.0, 0.2, 0.1)
        minutes += 1
    assert minutes == 8
    assert not state.watch["is_steady"][0]
    np.testing.assert_allclose(state.mean[[CHAIN, RAIN]], [0.1, 0.0])
    expected = calm.covariance[CHAIN, CHAIN] + calm.covariance[RAIN, RAIN]
    np.testing.assert_allclose(state.covariance[CHAIN, CHAIN], expected)
    assert np.linalg.eigvalsh(state.covariance).min() > 0.0


def minutes_until_dry(calm, rain_db, longest=240):
    state = calm.with_watch(is_raining=True)
    for minute in range(1, longest + 1):
        state = passed(state, 1.0, 0.0, rain_db(minute))
        if not state.watch["is_raining"][0]:
            return minute, bool(state.watch["is_steady"][0])
    return longest + 1, False


def test_a_small_steady_fall_is_a_step_of_the_chain_after_ninety_minutes(calm):
    assert minutes_until_dry(calm, lambda _minute: 0.4) == (90, True)
    assert minutes_until_dry(calm, lambda _minute: 3.0) == (241, False)
    assert minutes_until_dry(calm, lambda minute: 0.6 + 0.3 * (minute % 2)) == (241, False)
