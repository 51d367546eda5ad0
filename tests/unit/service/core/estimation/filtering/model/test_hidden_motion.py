"""Claims about torques and shares that move the spacecraft and stand in no level."""

import filter_models
import numpy as np
import pytest
from scipy.linalg import expm

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.filter_predict import Weather, predict, waiting_loss_deg
from service.core.estimation.filtering.state_changes import with_share, with_stated_torque, with_torque, without_shares
from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    RATE,
    FilterSettings,
    KnownMotion,
    core_size,
    hidden_count,
    initial_gaussian,
    no_motion,
    pattern_change,
)
from service.core.estimation.filtering.state_changes import (
    dropped,
    hidden_transition,
    inserted,
    torque_states,
    with_doubted_torque,
)
from service.core.estimation.filtering.plant import TORQUES, torque_prior_deg_h2

MINUTE_US, HOUR_US, DAY_US = 60_000_000, 3_600_000_000, 86_400_000_000
CARRIERS = 16
ZEROS = np.zeros(3)
#: 5e-7 N m on 2600, 2600 and 1400 kg m2
PUSHED = FilterSettings(torque_deg_h2=(0.143, 0.143, 0.265))
CALM = FilterSettings()


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=CARRIERS, common=1)


def aligned(model, settings=PUSHED):
    sigma = np.array([0.01, 0.005, 0.005])
    references = np.full(model.carriers, 0.03)
    state = initial_gaussian(model, ZEROS, sigma, references, drift_deg_h=settings.drift_deg_h)
    return with_torque(model, state, settings)


def weather(model):
    return Weather(False, (False, False, False), 1.0, np.zeros(model.carriers))


# ---- what torques do ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("coupling", [0.2625162, 0.0])
@pytest.mark.parametrize("step_us", [1_000_000, MINUTE_US, HOUR_US, 31 * HOUR_US])
@pytest.mark.parametrize("from_us", [0, 7 * HOUR_US + 1])
def test_what_torques_add_is_the_matrix_exponential(coupling, step_us, from_us):
    """Attitude, rate, constant, and a wave that goes round: p' = w q, q' = -w p."""
    settings = PUSHED._replace(coupling_per_h=coupling)
    matrix, around = np.zeros((15, 15)), 2.0 * np.pi / 24.0
    matrix[0, 1], matrix[1, 0] = -coupling, coupling
    matrix[0:3, 3:6] = matrix[3:6, 6:9] = matrix[3:6, 9:12] = np.eye(3)
    matrix[9:12, 12:15], matrix[12:15, 9:12] = around * np.eye(3), -around * np.eye(3)
    moved = expm(matrix * step_us / HOUR_US)
    phase = 2.0 * np.pi * from_us / DAY_US
    begun = np.kron([[1, 0, 0], [0, np.cos(phase), np.sin(phase)], [0, -np.sin(phase), np.cos(phase)]], np.eye(3))
    expected = moved[0:6, 6:15] @ begun
    added = hidden_transition(TORQUES, from_us, step_us, settings, no_motion())
    hours = step_us / HOUR_US
    # in units of what a constant does; the exponential itself loses 1e-12 over a day
    scale = np.repeat([0.5 * hours**2, hours], 3)[:, None]
    np.testing.assert_allclose(added[[0, 1, 2, 6, 7, 8]] / scale, expected / scale, rtol=0.0, atol=1e-11)
    assert not added[3:6].any()


def test_a_constant_roll_torque_shows_in_yaw_too(model):
    state = aligned(model)
    roll = core_size(model) + 1
    state.mean[roll] = 0.1
    moved, _ = predict(model, PUSHED, state, 6 * HOUR_US, no_motion(), weather(model))
    # what was learned fades by 0.00025 in six hours; roll'' = a - w^2 roll, yaw' = -w roll
    turn = PUSHED.coupling_per_h * 6.0
    assert moved.mean[1] == pytest.approx(0.1 * (1.0 - np.cos(turn)) / PUSHED.coupling_per_h**2, rel=5e-4)
    assert moved.mean[0] == pytest.approx(-0.1 * (turn - np.sin(turn)) / PUSHED.coupling_per_h**2, rel=5e-4)
    assert moved.mean[2] == 0.0


@pytest.mark.parametrize("hour", [0.0, 5.0, 13.3])
def test_the_torque_has_the_stated_size_at_every_hour(model, hour):
    state = aligned(model)
    positions = torque_states(model, state, 0)
    phase = 2.0 * np.pi * hour / 24.0
    now = np.kron([1.0, np.cos(phase), np.sin(phase)], np.eye(3))
    variance = np.diag(now @ state.covariance[positions, positions] @ now.T)
    np.testing.assert_allclose(np.sqrt(variance), PUSHED.torque_deg_h2, rtol=1e-12)


@pytest.mark.parametrize("shares", [0, 1])
def test_waiting_two_hours_costs_what_the_torque_turns(model, shares):
    settings = PUSHED._replace(coupling_per_h=0.0)
    state = aligned(model, settings)
    state = inserted(state, core_size(model), np.eye(shares))
    torque = torque_states(model, state, shares)
    known = np.zeros_like(state.covariance)
    # angles that may as well be none
    known[:9, :9] = np.eye(9)
    state.mean[:9] = 0.2
    # half of the acceleration by the square of the hours
    state.mean[torque.start + 2] = -0.1
    found = waiting_loss_deg(model, settings, state._replace(covariance=known), 0)
    np.testing.assert_allclose(found, [0.0, 0.0, 0.2], atol=1e-12)
    known[torque.start, torque.start] = 0.05**2
    found = waiting_loss_deg(model, settings, state._replace(covariance=known), 0)
    np.testing.assert_allclose(found, [0.2, 0.0, 0.2], atol=1e-12)
    np.testing.assert_array_equal(waiting_loss_deg(model, CALM, aligned(model, CALM), 0), ZEROS)


@pytest.mark.parametrize("settings", [CALM, PUSHED], ids=["calm", "pushed"])
def test_waiting_two_hours_costs_the_angle_that_surely_is_there_then(model, settings):
    settings = settings._replace(coupling_per_h=0.0)
    state = aligned(model, settings)
    known = np.zeros_like(state.covariance)
    state.mean[ATTITUDE] = 1.0, -0.3, 0.3
    state.mean[RATE] = 0.0, -0.25, -0.15
    known[0, 0] = 0.2**2
    known[RATE.start + 1, RATE.start + 1] = 0.05**2
    found = waiting_loss_deg(model, settings, state._replace(covariance=known), 0)
    # less four sigmas
    np.testing.assert_allclose(found, [0.2, 0.4, 0.0], atol=1e-12)


def test_what_is_learned_holds_for_weeks(model):
    state = aligned(model)
    positions = torque_states(model, state, 0)
    state.mean[positions] = 0.1
    state.covariance[positions, positions] *= 1e-6
    later, _ = predict(model, PUSHED, state, 14 * DAY_US, no_motion(), weather(model))
    np.testing.assert_allclose(later.mean[positions], 0.1, rtol=0.02)
    sigma = np.sqrt(np.diag(later.covariance)[positions]) / torque_prior_deg_h2(PUSHED)
    # sqrt(2 * 14 / 1000) of what was stated
    np.testing.assert_allclose(sigma, 0.166, atol=0.002)


def test_nothing_stated_leaves_no_state(model):
    state = aligned(model, CALM)
    assert hidden_count(model, len(state.mean)) == 0
    assert torque_states(model, state, 0) is None


def test_shares_that_nobody_told_of_are_refused(model):
    with pytest.raises(ValueError, match="1 commands are unreported"):
        hidden_transition(TORQUES, 0, MINUTE_US, PUSHED, no_motion()._replace(unreported=np.zeros((1, 2, 3))))


def test_states_come_and_go_without_a_trace(model):
    state = aligned(model)
    one = inserted(state, 5, np.diag([1.0, 4.0]))
    np.testing.assert_array_equal(np.diag(one.covariance)[5:7], [1.0, 4.0])
    again = dropped(one, slice(5, 7))
    np.testing.assert_array_equal(again.mean, state.mean)
    np.testing.assert_array_equal(again.covariance, state.covariance)


def test_a_share_stands_before_the_torques_and_goes_again(model):
    state = start(model, 0, aligned(model))
    minute_update = state._replace(command=state.command._replace(sensitivity=np.ones((len(state.gaussian.mean), 2))))
    shared = with_share(model, minute_update, 0)
    position = core_size(model)
    assert shared.gaussian.covariance[position, position] == 1.0
    assert torque_states(model, shared.gaussian, 1).start == position + 1
    assert not shared.command.sensitivity[position].any()
    gone = without_shares(model, shared, 1)
    np.testing.assert_array_equal(gone.gaussian.covariance, state.gaussian.covariance)
    np.testing.assert_array_equal(gone.command.sensitivity, minute_update.command.sensitivity)


def test_another_statement_of_the_catalogue_brings_widens_and_ends_the_torque(model):
    calm = start(model, 0, aligned(model, CALM))
    pushed = with_stated_torque(model, calm, 0, CALM, PUSHED)
    np.testing.assert_array_equal(pushed.gaussian.covariance, aligned(model).covariance)
    twice = PUSHED._replace(torque_deg_h2=tuple(2.0 * np.array(PUSHED.torque_deg_h2)))
    wider = with_stated_torque(model, pushed, 0, PUSHED, twice)
    positions = torque_states(model, wider.gaussian, 0)
    np.testing.assert_allclose(np.sqrt(np.diag(wider.gaussian.covariance)[positions]), torque_prior_deg_h2(twice))
    ended = with_stated_torque(model, pushed, 0, PUSHED, CALM)
    np.testing.assert_array_equal(ended.gaussian.mean, calm.gaussian.mean)


# ---- a spacecraft under a torque
# -----------------------------------------------------------------------------------------


class OrbitalFrameSpacecraft:
    """A spacecraft that a torque turns about pitch, kept near zero by commands; pitch is not coupled."""

    def __init__(self, model, settings, torque_deg_h2, seed=5):
        self.model, self.settings, self.rng = model, settings, np.random.default_rng(seed)
        self.state = start(model, 0, aligned(model, settings))
        self.attitude_deg, self.rate_deg_h, self.torque_deg_h2 = np.zeros(3), 0.0, torque_deg_h2
        self.reported = []

    def fly(self, minutes, share=1.0, jump_deg=0.0):
        """Fly on; every ten minutes half of the attitude is taken away by a command that a share is carried out of."""
        self.attitude_deg[2] += jump_deg
        for minute in range(minutes):
            command = np.zeros(3)
            if minute % 10 == 0 and self.reported:
                command[2] = -0.5 * self.reported[-1].attitude_deg[2] - 0.15 * self.state.gaussian.mean[8]
            self.attitude_deg[2] += self.rate_deg_h / 60.0 + share * command[2]
            self.rate_deg_h += self.torque_deg_h2 / 60.0
            level_db = pattern_change(self.model, self.attitude_deg).deviation_db
            row = level_db + self.model.white_sigma_db * self.rng.standard_normal(CARRIERS)
            known = KnownMotion(command, ZEROS, ZEROS)
            epoch_us = self.state.epoch_us + MINUTE_US
            self.reported.append(step(self.model, self.settings, self.state, epoch_us, row, known))
            self.state = self.reported[-1].state
        return self.reported[-1]

    @property
    def reasons(self):
        return {reason for reported in self.reported for reason in reported.integrity.reasons}


def test_a_torque_is_learned_and_is_no_unannounced_motion(model):
    spacecraft = OrbitalFrameSpacecraft(model, PUSHED, 0.2)
    spacecraft.fly(240)
    assert "unannounced_motion" not in spacecraft.reasons
    positions = torque_states(model, spacecraft.state.gaussian, 0)
    phase = 2.0 * np.pi * 4.0 / 24.0
    now = np.array([1.0, np.cos(phase), np.sin(phase)])
    block = np.arange(positions.start + 2, positions.stop, 3)
    identified = now @ spacecraft.state.gaussian.mean[block]
    sigma = np.sqrt(now @ spacecraft.state.gaussian.covariance[np.ix_(block, block)] @ now)
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
    state = aligned(model)
    doubted = with_doubted_torque(model, state, PUSHED, np.array([False, True, False]))
    grown = np.sqrt(np.diag(doubted.covariance) - np.diag(state.covariance))
    position = core_size(model) + 1
    np.testing.assert_array_equal(np.flatnonzero(grown), [7, position])
    # five times what was stated, for two hours
    np.testing.assert_allclose(grown[[7, position]], [10.0 * 0.143, 5.0 * 0.143])
    calm = aligned(model, CALM)
    assert with_doubted_torque(model, calm, CALM, np.ones(3, dtype=bool)) is calm


def test_a_torque_that_nobody_stated_so_great_is_followed_an_alarm_later(model):
    """Twelve times: commands are doubted for an hour first; then the torque is widened and control goes on."""
    spacecraft = OrbitalFrameSpacecraft(model, PUSHED._replace(torque_deg_h2=(0.01, 0.01, 0.02)), 0.25)
    spacecraft.fly(300)
    assert any(reported.state.motion.alarms[2] > 0.0 for reported in spacecraft.reported)
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
        if spacecraft.state.command.is_doubted:
            break
    assert spacecraft.state.command.share == -1.0
    assert "unannounced_motion" in spacecraft.reported[-1].integrity.reasons
    # found after half an hour, before the spacecraft is lost
    assert abs(spacecraft.attitude_deg[2]) < 0.4
