"""State of a running filter under another plan, another statement of the catalogue, other commands."""

import filter_models
import numpy as np
import pytest
from filter_rows import step

from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    FREE_REFERENCE_DB2,
    CarrierModel,
    FedForward,
    FilterSettings,
    carrier_states,
    core_size,
    hidden_count,
    initial_gaussian,
    no_motion,
)
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.plant import DAY_US, filter_model, torque_prior_deg_h2
from service.core.estimation.filtering.state_changes import (
    carry_over,
    dropped,
    inserted,
    torque_states,
    with_share,
    with_stated_torque,
    with_torque,
    without_shares,
)

MINUTE_US = 60_000_000
#: 5e-7 N m on 2600, 2600 and 1400 kg m2
PUSHED = FilterSettings(torque_deg_h2=(0.143, 0.143, 0.265))
CALM = FilterSettings()
TOLD = FilterSettings(fed_forward=FedForward((0.0, 0.0, 0.5), (1.6, 3.9, 0.0), (1.6, 0.0, 3.8), 0.06, 0.01, DAY_US))


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=8, common=1)


def aligned(model, settings=PUSHED):
    sigma, references = np.array([0.01, 0.005, 0.005]), np.full(model.carriers, 0.03)
    gaussian = initial_gaussian(model, np.zeros(3), sigma, references, drift_deg_h=settings.drift_deg_h)
    return start(model, 0, with_torque(model, gaussian, settings))


def test_nothing_stated_leaves_no_state(model):
    states = len(aligned(model, CALM).mean)
    assert hidden_count(model, states) == 0
    assert torque_states(model, states, 0) is None


def test_states_come_and_go_without_a_trace(model):
    state = aligned(model).gaussian
    one = inserted(state, 5, np.diag([1.0, 4.0]))
    np.testing.assert_array_equal(np.diag(one.covariance)[5:7], [1.0, 4.0])
    again = dropped(one, slice(5, 7))
    np.testing.assert_array_equal(again.mean, state.mean)
    np.testing.assert_array_equal(again.covariance, state.covariance)


def test_a_share_stands_before_the_torques_and_goes_again(model):
    before = aligned(model)
    before.sensitivity[:] = 1.0
    shared = with_share(model, before, 0)
    position = core_size(model)
    assert shared.covariance[position, position] == 1.0
    assert torque_states(model, len(shared.mean), 1).start == position + 1
    assert not shared.sensitivity[position].any()
    gone = without_shares(model, shared, 1)
    assert filter_models.bits(gone) == filter_models.bits(before)


def test_another_statement_of_the_catalogue_brings_widens_and_ends_the_torque(model):
    calm = aligned(model, CALM)
    pushed = with_stated_torque(model, calm, 0, CALM, PUSHED)
    np.testing.assert_array_equal(pushed.covariance, aligned(model).covariance)
    twice = PUSHED._replace(torque_deg_h2=tuple(2.0 * np.array(PUSHED.torque_deg_h2)))
    wider = with_stated_torque(model, pushed, 0, PUSHED, twice)
    positions = torque_states(model, len(wider.mean), 0)
    np.testing.assert_allclose(np.sqrt(np.diag(wider.covariance)[positions]), torque_prior_deg_h2(twice))
    ended = with_stated_torque(model, pushed, 0, PUSHED, CALM)
    np.testing.assert_array_equal(ended.mean, calm.mean)


def test_another_profile_is_learned_again_and_none_ends_it(model):
    pushed = aligned(model, TOLD)
    pushed.mean[core_size(model)] = 0.3
    twice = TOLD._replace(fed_forward=TOLD.fed_forward._replace(cosine_deg_h2=(3.2, 7.8, 0.0)))
    again = with_stated_torque(model, pushed, 0, TOLD, twice)
    np.testing.assert_array_equal(again.covariance, aligned(model, twice).covariance)
    assert not again.mean.any()
    ended = with_stated_torque(model, again, 0, twice, FilterSettings())
    np.testing.assert_array_equal(ended.covariance, aligned(model, FilterSettings()).covariance)
    same = with_stated_torque(model, pushed, 0, TOLD, TOLD._replace(torque_deg_h2=(0.1, 0.1, 0.1)))
    assert same.mean[core_size(model)] == 0.3


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
        reported = step(filter_model(model), steered, steered.epoch_us + MINUTE_US, row, no_motion())
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
    np.testing.assert_array_equal(same.mean, steered.mean)
    np.testing.assert_array_equal(same.covariance, steered.covariance)
    np.testing.assert_array_equal(same.carriers["is_flagged"], steered.carriers["is_flagged"])
    np.testing.assert_array_equal(same.carriers["minute_total"], steered.carriers["minute_total"])
    np.testing.assert_array_equal(same.carriers["white_scale"], steered.carriers["white_scale"])


def test_staying_carriers_keep_what_they_share_with_the_attitude(old, steered):
    new = picked(old, PLACE)
    after = changed(old, steered).gaussian
    staying = np.flatnonzero(STAYING)
    here, there = carrier_states(new, staying).ravel(), carrier_states(old, PLACE[staying]).ravel()
    np.testing.assert_array_equal(after.mean[here], steered.mean[there])
    np.testing.assert_array_equal(
        after.covariance[ATTITUDE][:, here], steered.covariance[ATTITUDE][:, there], strict=True
    )
    np.testing.assert_array_equal(after.covariance[np.ix_(here, here)], steered.covariance[np.ix_(there, there)])
    np.testing.assert_array_equal(after.mean[:12], steered.mean[:12])  # 11 of the core and one common part
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
    plain = step(filter_model(new), changed(old, steered), epoch_us, row, no_motion())
    moved = step(filter_model(new), changed(old, steered, reference_db=0.7), epoch_us, row + 0.7, no_motion())
    # the same numbers up to rounding of levels of some dB
    np.testing.assert_allclose(moved.carriers["innovation_db"], plain.carriers["innovation_db"], atol=1e-12)
    np.testing.assert_allclose(moved.state.aside_db, plain.state.aside_db + 0.7, atol=1e-12)


def test_unknown_carriers_show_their_level_first(old, steered):
    new = picked(old, PLACE)
    after = changed(old, steered, is_unknown=~STAYING)
    positions = carrier_states(new, np.flatnonzero(~STAYING))
    np.testing.assert_array_equal(after.covariance[positions[-1], positions[-1]], FREE_REFERENCE_DB2)
    rng, level_db = np.random.default_rng(9), np.where(STAYING, 0.0, 4.0)
    level_db[5] = 2.0  # carrier 5 of the old plan, which had stepped before
    reported = driven(new, after, 10, rng, level_db)
    assert not np.isin(reported.used, np.flatnonzero(~STAYING)).any()
    reported = driven(new, reported.state, 40, rng, level_db)
    assert len(reported.used) == new.carriers
    assert reported.state.carriers["is_relearned"][~STAYING].all()
    assert (np.abs(reported.attitude_deg) < 4.0 * reported.sigma_deg).all()


def test_a_staying_carrier_whose_level_is_void_begins_again(old, steered):
    unknown = np.arange(len(PLACE)) == 2
    after = changed(old, steered, is_unknown=unknown)
    positions = carrier_states(picked(old, PLACE), np.array([2]))[:, 0]
    np.testing.assert_array_equal(after.mean[positions], 0.0)
    assert after.carriers["is_flagged"][2]


def test_another_ladder_of_correlation_times_begins_at_its_stationary_noise(old, steered):
    new = filter_models.carrier_model(common=2, components=3)
    everyone = np.arange(old.carriers)
    none = np.zeros(old.carriers)
    after = carry_over(old, new, steered, everyone, none, none, none > 0.0).gaussian
    here, there = carrier_states(new, everyone), carrier_states(old, everyone)
    np.testing.assert_array_equal(after.mean[here[:-1]], 0.0)
    np.testing.assert_array_equal(np.diagonal(after.covariance)[here[:-1]], new.coloured_sigma_db.T**2)
    np.testing.assert_array_equal(after.mean[here[-1]], steered.mean[there[-1]])
    np.testing.assert_array_equal(np.diagonal(after.covariance)[11:13], new.common_sigma_db**2)


def test_doubts_about_commands_stay_and_their_sums_begin_again(old, steered):
    steered = steered.with_watch(share=-1.0, doubted_minutes=20.0, score=1.0, information=1.0)
    after = changed(old, steered._replace(sensitivity=np.ones_like(steered.sensitivity)))
    assert (after.watch["share"][0], after.watch["doubted_minutes"][0]) == (-1.0, 20.0)
    assert after.sensitivity.shape == (len(after.mean), 2)
    for evidence in (after.sensitivity, after.watch["score"], after.watch["information"]):
        assert not evidence.any()


def test_what_was_found_of_staying_carriers_goes_with_them(old, steered):
    numbers = np.arange(old.carriers, dtype=float)
    steered = steered.with_carriers(up=numbers, aligned_reference_db=numbers, flagged_minutes=numbers)
    after = changed(old, steered, reference_db=0.7)
    staying = numbers[PLACE[STAYING]]
    np.testing.assert_array_equal(after.carriers["up"][STAYING], staying)
    np.testing.assert_array_equal(after.carriers["flagged_minutes"][STAYING], staying)
    np.testing.assert_allclose(after.carriers["aligned_reference_db"][STAYING], staying + 0.7)
    np.testing.assert_array_equal(after.aside_db[:, STAYING], steered.aside_db[:, PLACE[STAYING]] + 0.7)
    assert not after.carriers["up"][~STAYING].any()
    # the anchor asks again
    assert np.isnan(after.anchor).all()
    assert after.watch["anchor_minutes"][0] == 0
