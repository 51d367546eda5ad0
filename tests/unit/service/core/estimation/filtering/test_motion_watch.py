"""Assumptions watched: unannounced motion and the torque that may explain it, noise, drift."""

import filter_models
import numpy as np
import pytest
from filter_rows import step

from service.core.estimation.filtering.filter_model import (
    DRIFT,
    FilterSettings,
    KnownMotion,
    core_size,
    pattern_change,
)
from service.core.estimation.filtering.filter_state import initial_watch, start
from service.core.estimation.filtering.motion_watch import (
    FOLLOWED_MINUTES,
    LARGEST,
    SLOW_LIMITS,
    alarmed_axes,
    doubt_torque,
    drift_scale,
    follow_jump,
    forget_shifts,
    newly_explained,
    pass_motion,
    push_drift,
    push_noise,
    push_shift,
    raise_alarms,
)
from service.core.estimation.filtering.plant import filter_model
from service.core.estimation.filtering.state_changes import torque_states, with_torque

MINUTE_US, CARRIERS = filter_models.MINUTE_US, 16
ZEROS, NOBODY = np.zeros(3), np.zeros(3, dtype=bool)
#: 5e-7 N m on 2600, 2600 and 1400 kg m2
PUSHED = FilterSettings(torque_deg_h2=(0.143, 0.143, 0.265))
CALM = FilterSettings()


def take_shift(watch, epoch_us, shift, *, is_pushed=False):
    """Count a row as the filter does it, in place, and return the axes that a torque is to explain from it on."""
    before = watch["alarms"].copy()
    watch["epoch_us"] = epoch_us
    push_shift(watch, shift)
    raise_alarms(watch, alarmed_axes(watch), is_pushed)
    return newly_explained(before, watch)


def unannounced(watch):
    return (watch["reported_minutes"] > 0.0).tolist()


def test_shifts_of_one_sign_raise_their_axis_for_an_hour():
    watch = initial_watch(0)[0]
    for minute in range(1, 20):
        take_shift(watch, minute * MINUTE_US, np.array([0.1, -1.6, 0.5]))
        if any(unannounced(watch)):
            break
    assert minute == 10  # 10 (1.6 - 0.6) > 9
    assert unannounced(watch) == [False, True, False]
    for _ in range(int(FOLLOWED_MINUTES)):
        assert unannounced(watch)[1]
        pass_motion(watch, 1.0)
    assert not any(unannounced(watch))


def reported_minutes(minutes, **settings):
    """Return for each minute of a steady shift of roll whether it is followed, reported, and newly explained."""
    watch, announced = initial_watch(0)[0], []
    for minute in range(1, minutes):
        pass_motion(watch, 1.0)
        explained = take_shift(watch, minute * MINUTE_US, np.array([0.0, 1.6, 0.0]), **settings)
        announced.append((watch["followed_minutes"][1] > 0.0, unannounced(watch)[1], bool(explained[1])))
    assert unannounced(watch)[0::2] == [False, False]
    return announced


def test_where_a_torque_acts_the_first_alarm_follows_and_the_second_is_reported():
    announced = reported_minutes(30, is_pushed=True)
    # ten minutes to an alarm: followed, and widened; ten more to the next one, which is reported, and widens again
    assert announced.index((True, False, True)) == 9
    assert [minute for minute, one in enumerate(announced) if one[2]] == [9, 19]
    assert [one[1] for one in announced].index(True) == 19


def test_what_a_torque_may_explain_is_reported_for_a_quarter_of_an_hour():
    """Before: an hour from the second alarm on. Two alarms, then the widened torque explains the shifts."""
    watch, reported = initial_watch(0)[0], 0
    for minute in range(1, 120):
        shift = np.array([0.0, 1.6 if minute <= 20 else 0.0, 0.0])
        pass_motion(watch, 1.0)
        take_shift(watch, minute * MINUTE_US, shift, is_pushed=True)
        reported += unannounced(watch)[1]
    assert reported == 15
    assert not watch["alarms"].any()  # still for an hour: the next alarm is a first one


def test_what_no_torque_explains_is_reported_for_an_hour():
    announced = reported_minutes(60, is_pushed=True)
    assert all(one[1] for one in announced[19:])
    watch = initial_watch(0)[0]
    follow_jump(watch)
    take_shift(watch, MINUTE_US, ZEROS, is_pushed=True)
    pass_motion(watch, FOLLOWED_MINUTES - 1.0)
    assert unannounced(watch) == [True, True, True]
    assert watch["jump_minutes"] == 1.0


def test_rows_inside_a_minute_wait_for_its_end():
    watch = initial_watch(0)[0]
    take_shift(watch, 10_000_000, np.full(3, 50.0))
    assert not any(unannounced(watch))
    forget_shifts(watch)
    take_shift(watch, 70_000_000, ZEROS)
    assert not any(unannounced(watch))


def calm_state(carriers):
    model = filter_models.carrier_model(carriers=carriers)
    return start(model, 0, filter_models.aligned(model))


def minute_update(values):
    """Return the state of a filter whose test values follow the factors: a wider sigma makes them smaller."""
    state = calm_state(values.shape[1])
    for row in values:
        tested = row / state.carriers["white_scale"]
        push_noise(state, tested, float(np.nansum(tested**2)), values.shape[1])
    return state


def test_what_the_model_says_keeps_the_factors_at_one():
    state = minute_update(np.random.default_rng(1).standard_normal((3000, 16)))
    assert abs(state.watch["slow_scale"][0] - 1.0) < 0.15  # six hours of memory over sixteen carriers
    assert np.abs(state.carriers["white_scale"] - 1.0).max() < 0.2
    assert abs(state.watch["nis_ratio"][0] - 1.0) < 0.1


def test_louder_white_noise_raises_its_own_carrier_only():
    values = np.random.default_rng(2).standard_normal((1500, 8))
    values[:, 3] *= 1.8
    state = minute_update(values)
    assert abs(state.carriers["white_scale"][3] - 1.8) < 0.25  # four hours of memory, outliers cut
    assert np.delete(state.carriers["white_scale"], 3).max() < 1.25


def test_slow_noise_that_the_model_does_not_know_raises_the_slow_factor():
    rng = np.random.default_rng(3)
    values, slow = rng.standard_normal((1500, 8)), np.zeros(8)
    for row in range(1500):
        slow = 0.98 * slow + 0.1 * rng.standard_normal(8)
        values[row] += slow
    state = minute_update(values)
    assert state.watch["slow_scale"][0] > 1.5
    assert minute_update(values * 9.0).watch["slow_scale"][0] <= SLOW_LIMITS[1]


def test_absent_carriers_teach_nothing():
    values = np.full((50, 4), np.nan)
    state = calm_state(4)
    for row in values:
        push_noise(state, row, 4.0, 4)
    assert state.watch["slow_scale"][0] == 1.0
    assert (state.carriers["white_scale"] == 1.0).all()


SIGMA = np.array(CALM.drift_deg_h)


def drifting(drift_deg_h, known_share=0.75):
    """Return mean and covariance of 12 places that know their drift to some share of the variance."""
    variance = np.full(12, 1e-4)
    variance[DRIFT] = (1.0 - known_share) * SIGMA**2
    mean = np.zeros(12)
    mean[DRIFT] = drift_deg_h
    return mean, np.diag(variance)


def drifted(ratio, minutes, known_share=0.75):
    """Return the logarithm of the factor after some minutes of a drift."""
    log_scale = 0.0
    for _ in range(minutes):
        log_scale = push_drift(*drifting(ratio * SIGMA, known_share), log_scale, SIGMA, 1.0)
    return log_scale


def test_a_usual_drift_leaves_the_settings_as_they_are():
    assert drift_scale(drifted(np.sqrt(0.75), 600)) == 1.0  # exactly what the model expects of the estimate


def test_a_small_drift_never_narrows_it():
    assert drifted(0.0, 600) == 0.0


def test_three_times_the_drift_is_learned_within_half_a_day():
    log_scale = drifted(3.0, 720)
    assert 2.0 <= drift_scale(log_scale) <= LARGEST
    # the prediction takes it up
    model = filter_models.carrier_model(carriers=4)
    state = start(model, 0, filter_models.aligned(model)).with_watch(log_drift_scale=log_scale)
    scaled = CALM._replace(drift_deg_h=tuple(drift_scale(log_scale) * SIGMA))
    wide = filter_models.coasted(filter_model(model), state, MINUTE_US)
    told = filter_models.coasted(filter_model(model, scaled), state.with_watch(log_drift_scale=0.0), MINUTE_US)
    np.testing.assert_allclose(wide.covariance, told.covariance, rtol=1e-12)


def test_the_factor_has_a_limit():
    assert drift_scale(drifted(50.0, 3000)) == pytest.approx(LARGEST)


def test_an_unknown_drift_says_nothing():
    assert drifted(3.0, 600, known_share=0.01) == 0.0


def test_a_step_of_the_factor_widens_the_drift_and_nothing_else():
    log_scale = 0.0866  # just below the first step of 2^(1/8)
    mean, covariance = drifting(3.0 * SIGMA)
    before = covariance.copy()
    assert drift_scale(push_drift(mean, covariance, log_scale, SIGMA, 1.0)) > drift_scale(log_scale)
    growth = covariance - before
    np.testing.assert_allclose(np.diagonal(growth)[DRIFT], (2.0**0.25 - 1.0) * SIGMA**2, rtol=1e-9)
    growth[DRIFT, DRIFT] = 0.0
    assert not growth.any()


def test_the_factor_follows_time_and_not_rows():
    one, many = push_drift(*drifting(3.0 * SIGMA), 0.0, SIGMA, 1.0), 0.0
    for _ in range(6):
        many = push_drift(*drifting(3.0 * SIGMA), many, SIGMA, 1.0 / 6.0)
    assert many == pytest.approx(one, rel=1e-12)


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=CARRIERS, common=1)


def aligned(model, settings):
    gaussian = filter_models.aligned(model, settings.drift_deg_h)
    return start(model, 0, with_torque(model, gaussian, settings))


class OrbitalFrameSpacecraft:
    """A spacecraft that a torque turns about pitch, kept near zero by commands; pitch is not coupled."""

    def __init__(self, model, settings, torque_deg_h2, seed=5):
        self.model, self.compiled, self.rng = model, filter_model(model, settings), np.random.default_rng(seed)
        self.state = aligned(model, settings)
        self.attitude_deg, self.rate_deg_h, self.torque_deg_h2 = np.zeros(3), 0.0, torque_deg_h2
        self.reported = []

    def fly(self, minutes, share=1.0, jump_deg=0.0):
        """Fly on; every ten minutes half of the attitude is taken away by a command that a share is carried out of."""
        self.attitude_deg[2] += jump_deg
        for minute in range(minutes):
            command = np.zeros(3)
            if minute % 10 == 0 and self.reported:
                command[2] = -0.5 * self.reported[-1].attitude_deg[2] - 0.15 * self.state.mean[8]
            self.attitude_deg[2] += self.rate_deg_h / 60.0 + share * command[2]
            self.rate_deg_h += self.torque_deg_h2 / 60.0
            level_db = pattern_change(self.model, self.attitude_deg).deviation_db
            row = level_db + self.model.white_sigma_db * self.rng.standard_normal(CARRIERS)
            known = KnownMotion(command, ZEROS, ZEROS)
            epoch_us = self.state.epoch_us + MINUTE_US
            self.reported.append(step(self.compiled, self.state, epoch_us, row, known))
            self.state = self.reported[-1].state
        return self.reported[-1]

    @property
    def reasons(self):
        return {reason for reported in self.reported for reason in reported.integrity.reasons}


def test_a_torque_is_learned_and_is_no_unannounced_motion(model):
    spacecraft = OrbitalFrameSpacecraft(model, PUSHED, 0.2)
    spacecraft.fly(240)
    assert "unannounced_motion" not in spacecraft.reasons
    positions = torque_states(model, len(spacecraft.state.mean), 0)
    phase = 2.0 * np.pi * 4.0 / 24.0
    now = np.array([1.0, np.cos(phase), np.sin(phase)])
    block = np.arange(positions.start + 2, positions.stop, 3)
    identified = now @ spacecraft.state.mean[block]
    sigma = np.sqrt(now @ spacecraft.state.covariance[np.ix_(block, block)] @ now)
    assert sigma < 0.3 * PUSHED.torque_deg_h2[2]
    assert abs(identified - 0.2) < 3.0 * sigma


def test_without_the_state_the_same_torque_stops_control(model):
    """The negative control: what the state is for."""
    spacecraft = OrbitalFrameSpacecraft(model, CALM, 0.2)
    spacecraft.fly(240)
    assert "unannounced_motion" in spacecraft.reasons


def test_a_torque_five_times_as_great_as_stated_is_followed_and_control_goes_on(model):
    settings = PUSHED._replace(torque_deg_h2=(0.03, 0.03, 0.05))
    spacecraft = OrbitalFrameSpacecraft(model, settings, 0.25)
    spacecraft.fly(300)
    assert "unannounced_motion" not in spacecraft.reasons
    assert np.abs([reported.attitude_deg[2] for reported in spacecraft.reported]).max() < 0.2


def test_an_alarm_about_motion_makes_the_torque_doubtful_and_the_rate_with_it(model):
    state, axes = aligned(model, PUSHED), np.array([False, True, False])
    doubted = filter_models.copied(state)
    doubt_torque(filter_model(model, PUSHED), doubted, axes, 0)
    grown = np.sqrt(np.diag(doubted.covariance) - np.diag(state.covariance))
    position = core_size(model) + 1
    np.testing.assert_array_equal(np.flatnonzero(grown), [7, position])
    # five times what was stated, for two hours
    np.testing.assert_allclose(grown[[7, position]], [10.0 * 0.143, 5.0 * 0.143])
    calm = aligned(model, CALM)
    doubted = filter_models.copied(calm)
    doubt_torque(filter_model(model, CALM), doubted, ~NOBODY, 0)
    assert filter_models.bits(doubted) == filter_models.bits(calm)


def test_a_torque_that_nobody_stated_so_great_is_followed_an_alarm_later(model):
    """Twelve times: commands are doubted for an hour first; then the torque is widened and control goes on."""
    spacecraft = OrbitalFrameSpacecraft(model, PUSHED._replace(torque_deg_h2=(0.01, 0.01, 0.02)), 0.25)
    spacecraft.fly(300)
    assert any(reported.state.watch["alarms"][0, 2] > 0.0 for reported in spacecraft.reported)
    assert not any("unannounced_motion" in reported.integrity.reasons for reported in spacecraft.reported[150:])
    assert abs(spacecraft.attitude_deg[2]) < 0.3


def test_a_forged_jump_of_two_degrees_stops_control_in_spite_of_the_torque(model):
    spacecraft = OrbitalFrameSpacecraft(model, PUSHED, 0.1)
    spacecraft.fly(60)
    spacecraft.reported.clear()
    reported = spacecraft.fly(5, jump_deg=2.0)
    assert "unannounced_motion" in spacecraft.reasons
    assert not reported.integrity.is_control_allowed


def test_reversed_commands_are_found_in_spite_of_the_torque(model):
    spacecraft = OrbitalFrameSpacecraft(model, PUSHED, 0.1)
    spacecraft.fly(60)
    spacecraft.reported.clear()
    for _ in range(4):
        spacecraft.fly(11, share=-1.0)
        if spacecraft.state.watch["doubted_minutes"][0] > 0.0:
            break
    assert spacecraft.state.watch["share"][0] == -1.0
    assert "unannounced_motion" in spacecraft.reported[-1].integrity.reasons
    # found after half an hour, before the spacecraft is lost
    assert abs(spacecraft.attitude_deg[2]) < 0.4
