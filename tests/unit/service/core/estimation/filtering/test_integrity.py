"""Integrity of a row: permission of control, its reasons, and the loss by waiting."""

import filter_models
import numpy as np
import pytest
from filter_rows import verdict_of

from service.core.estimation.filtering.filter_model import ATTITUDE, RATE, FilterSettings, core_size
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.integrity import assess, waiting_loss_deg
from service.core.estimation.filtering.plant import filter_model
from service.core.estimation.filtering.row_block import empty_result
from service.core.estimation.filtering.state_changes import inserted, torque_states, with_torque

MINUTE_US = 60_000_000
CARRIERS = 16
#: 5e-7 N m on 2600, 2600 and 1400 kg m2; roll and yaw do not exchange
PUSHED = FilterSettings(coupling_per_h=0.0, torque_deg_h2=(0.143, 0.143, 0.265))
CALM = FilterSettings(coupling_per_h=0.0)
CARRIER_MODEL = filter_models.carrier_model(carriers=CARRIERS, common=1)
#: sigma of the attitude, levels of the last answer, deg
SIGMA, LEVEL = np.array([0.09, 0.01, 0.02]), np.array([0.4, 0.08, 0.12])


def begun(settings):
    gaussian = filter_models.aligned(CARRIER_MODEL, settings.drift_deg_h)
    return start(CARRIER_MODEL, 0, with_torque(CARRIER_MODEL, gaussian, settings))


def situation(settings=CALM, *, sigma_deg=SIGMA, level_deg=LEVEL, nominal_deg=LEVEL, relearned=0, **watch):
    """Return a state of a row, its attitude known to a sigma since the last answer of the anchor."""
    carriers = np.arange(CARRIERS) < relearned
    found = {"level_deg": level_deg, "nominal_deg": nominal_deg, "answer_sigma_deg": sigma_deg} | watch
    state = begun(settings).with_carriers(is_relearned=carriers).with_watch(**found)
    state.covariance[:9] = state.covariance[:, :9] = 0.0
    state.covariance[ATTITUDE, ATTITUDE] = np.diag(np.square(sigma_deg))
    if settings is PUSHED:
        # the torque turns yaw and pitch by more than they are uncertain
        state.mean[torque_states(CARRIER_MODEL, len(state.mean), 0)][[0, 2]] = 0.4, 0.1
    return state


def judged(state, settings=CALM, carriers_used=CARRIERS):
    """Return the verdict on a state, in which until when figures inhibit is written."""
    found = empty_result(1, CARRIERS).rows[0]
    assess(filter_model(CARRIER_MODEL, settings), state, carriers_used, found)
    return verdict_of(found)


def verdict_on(settings=CALM, carriers_used=CARRIERS, **change):
    return judged(situation(settings, **change), settings, carriers_used)


def test_a_calm_row_allows_all_axes():
    verdict = verdict_on()
    assert verdict.is_control_allowed
    assert verdict.is_axis_allowed == (True, True, True)
    assert verdict.reasons == ()
    assert not verdict.is_realignment_advised


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"is_raining": True}, "downlink_fade"),
        ({"hold_minutes": 3.0}, "chain_step"),
        ({"sigma_deg": np.array([0.09, 0.061, 0.02])}, "sigma_roll"),
        ({"sigma_deg": np.array([0.09, 0.01, 0.101])}, "sigma_pitch"),
        ({"level_deg": np.array([0.4, 0.08, 0.23])}, "protection_level"),
        ({"level_deg": np.array([0.4, 0.23, 0.12])}, "protection_level"),
        ({"level_deg": np.array([0.4, np.nan, 0.12])}, "integrity_unmonitored"),
        ({"carriers_used": 5}, "redundancy"),
        ({"nis_ratio": 2.1}, "innovations"),
        ({"reported_minutes": (0.0, 3.0, 0.0)}, "unannounced_motion"),
        ({"doubted_minutes": 3.0}, "unannounced_motion"),
        ({"jump_minutes": 3.0}, "unannounced_motion"),
    ],
)
def test_each_condition_withholds_control_and_says_so(change, reason):
    verdict = verdict_on(**change)
    assert verdict.reasons == (reason,)
    assert verdict.is_axis_allowed == (False, False, False)


def test_a_sigma_that_is_not_known_is_beyond_its_limit():
    verdict = verdict_on(sigma_deg=np.array([0.09, 0.01, np.nan]))
    # neither are levels that grow with it
    assert verdict.reasons == ("integrity_unmonitored", "sigma_pitch")


LESS_CERTAIN = [
    {"sigma_deg": np.array([0.5, 0.2, 0.3])},
    {"level_deg": np.array([0.4, 0.08, 0.23]), "nominal_deg": np.array([0.4, 0.08, 0.16])},
    {"reported_minutes": (3.0, 3.0, 3.0)},
]
WRONG_IN_KIND = [
    {"is_raining": True},
    {"hold_minutes": 3.0},
    {"level_deg": np.array([0.4, 0.08, 0.25]), "nominal_deg": np.array([0.4, 0.08, 0.16])},
    {"level_deg": np.array([0.4, np.nan, 0.12])},
    {"carriers_used": 5},
    {"nis_ratio": 2.1},
    {"doubted_minutes": 3.0},
    {"jump_minutes": 3.0},
]


@pytest.mark.parametrize("change", LESS_CERTAIN)
def test_less_certain_is_used_where_something_is_lost_by_waiting(change):
    assert verdict_on(PUSHED, **change).is_axis_allowed == (True, True, True)


@pytest.mark.parametrize("change", WRONG_IN_KIND)
def test_wrong_in_kind_is_not_used_whatever_is_lost(change):
    assert verdict_on(PUSHED, **change).is_axis_allowed == (False, False, False)


def test_a_figure_that_passed_its_limit_inhibits_for_ten_minutes():
    def of_levels(levels_deg):
        state, allowed = situation(), []
        for minute, level in enumerate(levels_deg):
            epoch_us = minute * MINUTE_US
            state = state.with_watch(epoch_us=epoch_us, answered_us=epoch_us, level_deg=(0.4, 0.08, level))
            allowed.append(judged(state).is_control_allowed)
        return allowed

    assert of_levels([0.21, 0.23, *[0.17] * 12]) == [True] + [False] * 10 + [True] * 3
    # what flickers about its limit changes once
    assert of_levels([0.23, 0.21] * 20) == [False] * 40


@pytest.mark.parametrize("change", [{"sigma_deg": np.array([0.14, 0.01, 0.02])}, {"reported_minutes": (3.0, 0.0, 0.0)}])
def test_yaw_alone_may_be_withheld(change):
    verdict = verdict_on(**change)
    assert verdict.is_control_allowed
    assert verdict.is_axis_allowed == (False, True, True)
    assert verdict_on(PUSHED, **change).is_axis_allowed == (True, True, True)


def test_a_third_of_the_references_learned_anew_advises_an_alignment():
    assert not verdict_on(relearned=5).is_realignment_advised
    assert verdict_on(relearned=6).is_realignment_advised


def loss_deg(settings, mean, covariance):
    return waiting_loss_deg(filter_model(CARRIER_MODEL, settings), mean, covariance, 0)


@pytest.mark.parametrize("shares", [0, 1])
def test_waiting_two_hours_costs_what_the_torque_turns(shares):
    state = inserted(begun(PUSHED).gaussian, core_size(CARRIER_MODEL), np.eye(shares))
    torque = torque_states(CARRIER_MODEL, len(state.mean), shares)
    known = np.zeros_like(state.covariance)
    # angles that may as well be none
    known[:9, :9] = np.eye(9)
    state.mean[:9] = 0.2
    # half of the acceleration by the square of the hours
    state.mean[torque.start + 2] = -0.1
    found = loss_deg(PUSHED, state.mean, known)
    np.testing.assert_allclose(found, [0.0, 0.0, 0.2], atol=1e-12)
    known[torque.start, torque.start] = 0.05**2
    found = loss_deg(PUSHED, state.mean, known)
    np.testing.assert_allclose(found, [0.2, 0.0, 0.2], atol=1e-12)
    np.testing.assert_array_equal(loss_deg(CALM, *begun(CALM).gaussian), np.zeros(3))


@pytest.mark.parametrize("settings", [CALM, PUSHED], ids=["calm", "pushed"])
def test_waiting_two_hours_costs_the_angle_that_surely_is_there_then(settings):
    state = begun(settings).gaussian
    known = np.zeros_like(state.covariance)
    state.mean[ATTITUDE] = 1.0, -0.3, 0.3
    state.mean[RATE] = 0.0, -0.25, -0.15
    known[0, 0] = 0.2**2
    known[RATE.start + 1, RATE.start + 1] = 0.05**2
    found = loss_deg(settings, state.mean, known)
    # less four sigmas
    np.testing.assert_allclose(found, [0.2, 0.4, 0.0], atol=1e-12)
