"""Claims about a filter whose carrier plan changes in operation."""

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.carry_over import carry_over
from service.core.estimation.filtering.model.filter_model import CarrierModel, FilterSettings, no_motion
from service.core.estimation.filtering.model.filter_state import ATTITUDE, FREE_REFERENCE_DB2, carrier_states

MINUTE_US = 60_000_000
SETTINGS = FilterSettings()
#: carriers 3 and 7 leave, the rest is turned round, two new ones come last
PLACE = np.array([11, 10, 9, 8, 6, 5, 4, 2, 1, 0, -1, -1])
STAYING = PLACE >= 0


def picked(model: CarrierModel, position: np.ndarray) -> CarrierModel:
    """Return the model of a plan made of another's carriers; new ones are copies of carrier 3."""
    rows = np.where(position >= 0, position, 3)
    shared = ("common_sigma_db", "common_tau_s")
    return CarrierModel(*[v if n in shared else v[rows] for n, v in model._asdict().items()])


def driven(model, state, count, rng, change_db=0.0):
    """Return what the last of some rows told."""
    for _ in range(count):
        row = change_db + model.white_sigma_db * rng.standard_normal(model.carriers)
        reported = step(model, SETTINGS, state, state.epoch_us + MINUTE_US, row, no_motion())
        state = reported.state
    return reported


@pytest.fixture
def old():
    return filter_models.carrier_model(common=1)


@pytest.fixture
def state(old):
    steps_db = np.where(np.arange(old.carriers) == 5, 2.0, 0.0)
    return driven(old, start(old, 0, filter_models.aligned(old)), 90, np.random.default_rng(2), steps_db).state


def changed(old, state, position=PLACE, reference_db=0.0, is_unknown=False):
    count = len(position)
    args = np.full(count, reference_db), np.full(count, 0.5), np.broadcast_to(np.asarray(is_unknown), count)
    return carry_over(old, picked(old, position), state, position, *args)


def test_the_same_plan_is_the_same_state(old, state):
    same = changed(old, state, np.arange(old.carriers))
    np.testing.assert_array_equal(same.gaussian.mean, state.gaussian.mean)
    np.testing.assert_array_equal(same.gaussian.covariance, state.gaussian.covariance)
    np.testing.assert_array_equal(same.carriers.is_flagged, state.carriers.is_flagged)
    np.testing.assert_array_equal(same.minute.total, state.minute.total)
    np.testing.assert_array_equal(same.noise.white_scale, state.noise.white_scale)


def test_staying_carriers_keep_what_they_share_with_the_attitude(old, state):
    new = picked(old, PLACE)
    after = changed(old, state).gaussian
    staying = np.flatnonzero(STAYING)
    here, there = carrier_states(new, staying).ravel(), carrier_states(old, PLACE[staying]).ravel()
    np.testing.assert_array_equal(after.mean[here], state.gaussian.mean[there])
    np.testing.assert_array_equal(
        after.covariance[ATTITUDE][:, here], state.gaussian.covariance[ATTITUDE][:, there], strict=True
    )
    np.testing.assert_array_equal(after.covariance[np.ix_(here, here)], state.gaussian.covariance[np.ix_(there, there)])
    np.testing.assert_array_equal(after.mean[:12], state.gaussian.mean[:12])  # 11 of the core and one common part
    assert (np.linalg.eigvalsh(after.covariance) > 0.0).all()


def test_new_carriers_begin_with_the_sigma_they_are_given(old, state):
    new = picked(old, PLACE)
    after = changed(old, state).gaussian
    positions = carrier_states(new, np.flatnonzero(~STAYING))
    np.testing.assert_array_equal(after.mean[positions], 0.0)
    np.testing.assert_array_equal(after.covariance[positions[-1], positions[-1]], 0.5**2)
    assert np.count_nonzero(after.covariance[positions[-1, 0]]) == 1


def test_a_reference_that_moved_leaves_the_innovations_as_they_are(old, state):
    new = picked(old, PLACE)
    row = np.random.default_rng(5).normal(0.0, 0.1, new.carriers)
    epoch_us = state.epoch_us + MINUTE_US
    plain = step(new, SETTINGS, changed(old, state), epoch_us, row, no_motion())
    moved = step(new, SETTINGS, changed(old, state, reference_db=0.7), epoch_us, row + 0.7, no_motion())
    # the same numbers up to rounding of levels of some dB
    np.testing.assert_allclose(moved.innovation_db, plain.innovation_db, atol=1e-12)
    np.testing.assert_allclose(moved.state.carriers.residuals_db, plain.state.carriers.residuals_db + 0.7, atol=1e-12)


def test_flags_go_with_their_carriers(old, state):
    state = state._replace(carriers=state.carriers._replace(is_flagged=np.arange(old.carriers) == 8))
    np.testing.assert_array_equal(np.flatnonzero(changed(old, state).carriers.is_flagged), [3])


def test_unknown_carriers_show_their_level_first(old, state):
    new = picked(old, PLACE)
    after = changed(old, state, is_unknown=~STAYING)
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


def test_a_staying_carrier_whose_level_is_void_begins_anew(old, state):
    unknown = np.arange(len(PLACE)) == 2
    after = changed(old, state, is_unknown=unknown)
    positions = carrier_states(picked(old, PLACE), np.array([2]))[:, 0]
    np.testing.assert_array_equal(after.gaussian.mean[positions], 0.0)
    assert after.carriers.is_flagged[2]


def test_another_ladder_of_correlation_times_begins_at_its_stationary_noise(old, state):
    new = filter_models.carrier_model(common=2, components=3)
    everyone = np.arange(old.carriers)
    none = np.zeros(old.carriers)
    after = carry_over(old, new, state, everyone, none, none, none > 0.0).gaussian
    here, there = carrier_states(new, everyone), carrier_states(old, everyone)
    np.testing.assert_array_equal(after.mean[here[:-1]], 0.0)
    np.testing.assert_array_equal(np.diagonal(after.covariance)[here[:-1]], new.coloured_sigma_db.T**2)
    np.testing.assert_array_equal(after.mean[here[-1]], state.gaussian.mean[there[-1]])
    np.testing.assert_array_equal(np.diagonal(after.covariance)[11:13], new.common_sigma_db**2)


def test_doubts_about_commands_stay_and_their_sums_begin_anew(old, state):
    state = state._replace(command=state.command._replace(share=-1.0, minutes_left=20.0, sensitivity=np.ones((60, 2))))
    after = changed(old, state).command
    assert (after.share, after.minutes_left) == (-1.0, 20.0)
    assert after.sensitivity.size == 0
    assert not after.information.any()
