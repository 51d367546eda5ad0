"""Claims about the watch on commanded corrections."""

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.filter_update import innovate, update
from service.core.estimation.filtering.model.filter_model import FilterSettings, KnownMotion, no_motion, pattern_change
from service.core.estimation.filtering.watches.command_watch import (
    CommandWatch,
    believed_motion,
    executed_commands,
    judge_commands,
    likelier_share,
    pass_commands,
    push_row,
)

MINUTE_US = 60_000_000
CARRIERS = 16
SETTINGS = FilterSettings()
ZEROS = np.zeros(3)


class OrbitalFrameSpacecraft:
    """A spacecraft without drift that carries out a share of what is commanded."""

    def __init__(self, filter_models):
        self.model, self.rng = filter_models.carrier_model(carriers=CARRIERS), np.random.default_rng(8)
        self.state = start(self.model, 0, filter_models.aligned(self.model))
        self.attitude_deg, self.rate_deg_min = ZEROS, ZEROS
        self.announced = []

    def turn(self, minutes, rate_deg_min, share):
        """Command a rate about pitch (no coupling) for some minutes, return what the last row told."""
        moved = np.array([0.0, 0.0, rate_deg_min])
        for _ in range(minutes):
            self.attitude_deg = self.attitude_deg + share * moved
            self.measure(KnownMotion(moved, ZEROS, ZEROS))
        return self.announced[-1]

    def push(self, minutes, change_deg_h, share):
        """Command a torque about pitch each minute for some minutes, with the rate that it is to give."""
        change = np.array([0.0, 0.0, change_deg_h])
        for _ in range(minutes):
            self.attitude_deg = self.attitude_deg + self.rate_deg_min + share * change / 120.0
            self.rate_deg_min = self.rate_deg_min + share * change / 60.0
            self.measure(KnownMotion(ZEROS, ZEROS, change))

    def measure(self, known):
        level_db = pattern_change(self.model, self.attitude_deg).deviation_db
        row = level_db + self.model.white_sigma_db * self.rng.standard_normal(CARRIERS)
        self.announced.append(step(self.model, SETTINGS, self.state, self.state.epoch_us + MINUTE_US, row, known))
        self.state = self.announced[-1].state

    @property
    def doubted(self):
        return [row.state.command.is_doubted for row in self.announced]


@pytest.fixture
def spacecraft():
    return OrbitalFrameSpacecraft(filter_models)


def test_commands_that_are_obeyed_are_never_doubted(spacecraft):
    for sign in (1.0, -1.0, 1.0, -1.0):
        spacecraft.turn(60, sign * 0.004, 1.0)
    assert not any(spacecraft.doubted)


@pytest.mark.parametrize("share", [-1.0, 0.0, 2.0])
def test_commands_that_are_not_obeyed_are_found_and_the_share_is_believed(spacecraft, share):
    spacecraft.turn(30, 0.0, 1.0)
    spacecraft.turn(60, 0.004, share)  # 0.24 deg in an hour
    assert any(spacecraft.doubted)
    assert (
        np.argmax(spacecraft.doubted) - 30 <= 30
    )  # minutes, when 0.12 deg were commanded; the powers tell pitch to 0.03
    assert spacecraft.state.command.share == share
    # the share found is applied: the error stays what noise leaves
    assert abs(spacecraft.announced[-1].attitude_deg[2] - spacecraft.attitude_deg[2]) < 0.05
    assert "unannounced_motion" in spacecraft.announced[-1].integrity.reasons


def test_torques_that_act_as_announced_are_never_doubted(spacecraft):
    for sign in (1.0, -1.0, -1.0, 1.0):
        spacecraft.push(30, sign * 0.02, 1.0)
    assert not any(spacecraft.doubted)


@pytest.mark.parametrize("share", [-1.0, 0.0, 2.0])
def test_torques_that_act_otherwise_are_found_and_the_share_is_believed(spacecraft, share):
    """Each gives a rate that stays: what is announced grows with the square of the time."""
    spacecraft.turn(30, 0.0, 1.0)
    spacecraft.push(60, 0.01, share)  # 0.3 deg in an hour
    assert np.argmax(spacecraft.doubted) - 30 in range(60)
    assert spacecraft.state.command.share == share
    assert abs(spacecraft.announced[-1].attitude_deg[2] - spacecraft.attitude_deg[2]) < 0.05


def test_a_doubt_ends_after_an_hour(spacecraft):
    spacecraft.turn(30, 0.0, 1.0)
    spacecraft.turn(45, 0.004, -1.0)
    announced = spacecraft.turn(75, 0.0, 1.0)
    assert not announced.state.command.is_doubted
    assert announced.state.command.share == 1.0


def test_a_row_that_something_else_moved_says_nothing_about_commands(spacecraft):
    model, gaussian = spacecraft.model, spacecraft.state.gaussian
    known = KnownMotion(np.array([0.0, 0.1, 0.1]), ZEROS, ZEROS)
    nobody = np.zeros(CARRIERS, dtype=bool)
    watch = pass_commands(model, SETTINGS, executed_commands(), MINUTE_US, known, nobody, is_raining=False)
    everyone = np.arange(CARRIERS)
    used = innovate(model, gaussian, np.full(CARRIERS, 0.3), everyone, model.white_sigma_db**2)
    covariance = update(model, gaussian, np.full(CARRIERS, 0.3), used).state.covariance
    shared = push_row(model, watch, used, covariance, is_shared=True)
    assert not shared.score.any()
    assert not shared.information.any()
    announced = push_row(model, watch, used, covariance, is_shared=False)
    assert announced.information[0, 0] > 0.0
    np.testing.assert_array_equal(announced.sensitivity, shared.sensitivity)


def test_sums_are_those_of_the_innovations_covariance(spacecraft):
    """Score and information without an inverse are the ones with it."""
    model, gaussian = spacecraft.model, spacecraft.state.gaussian
    known = KnownMotion(np.array([0.05, 0.1, -0.1]), ZEROS, ZEROS)
    nobody = np.zeros(CARRIERS, dtype=bool)
    watch = pass_commands(model, SETTINGS, executed_commands(), MINUTE_US, known, nobody, is_raining=False)
    row = spacecraft.rng.normal(0.0, 0.05, CARRIERS)
    used = innovate(model, gaussian, row, np.arange(CARRIERS), model.white_sigma_db**2)
    after = push_row(model, watch, used, update(model, gaussian, row, used).state.covariance, is_shared=False)
    seen = used.core_jacobian[:, :3] @ watch.sensitivity[:3]
    whitened = np.linalg.solve(used.covariance_db2, seen)
    # rounding of the Joseph form; the attitude at an alignment is known to 0.005 deg
    np.testing.assert_allclose(after.score, whitened.T @ used.innovation_db, rtol=1e-6)
    np.testing.assert_allclose(after.information, whitened.T @ seen, rtol=1e-6)


def with_evidence(score, information, score_yaw=0.0, cross=0.0, information_yaw=0.0):
    matrix = np.array([[information, cross], [cross, information_yaw]])
    return CommandWatch(np.zeros((20, 2)), np.array([score, score_yaw]), matrix, 1.0, 0.0)


def test_the_likeliest_share_needs_evidence():
    assert likelier_share(with_evidence(-20.0, 20.0)) == 0.0
    assert likelier_share(with_evidence(-4.0, 4.0)) is None
    assert likelier_share(with_evidence(-20.0, 10.0)) == -1.0


def test_what_a_turn_of_yaw_explains_is_not_held_against_commands():
    assert likelier_share(with_evidence(-20.0, 20.0, -40.0, 40.0, 80.0)) is None
    assert likelier_share(with_evidence(-20.0, 20.0, 0.0, 0.0, 80.0)) == 0.0


@pytest.mark.parametrize(("reach_deg", "is_believed"), [(0.4, True), (0.6, False)])
def test_a_share_moves_the_attitude_by_half_a_degree_at_most(spacecraft, reach_deg, is_believed):
    """Beyond it the first order does not hold: control is told, the state stays."""
    gaussian = spacecraft.state.gaussian
    sensitivity = np.zeros((len(gaussian.mean), 2))
    sensitivity[1, 0] = reach_deg
    lost = with_evidence(-20.0, 20.0)._replace(sensitivity=sensitivity)
    watch, after = judge_commands(lost, gaussian)
    assert watch.is_doubted
    assert watch.share == (0.0 if is_believed else 1.0)
    moved_deg = after.mean[1] - gaussian.mean[1]
    assert moved_deg == pytest.approx(-reach_deg if is_believed else 0.0)


def test_a_believed_share_scales_the_commands():
    known = KnownMotion(np.array([0.1, 0.2, 0.3]), ZEROS, np.array([0.0, 2.0, 4.0]))
    assert believed_motion(executed_commands(), known) is known
    half = believed_motion(executed_commands()._replace(share=0.5, minutes_left=9.0), known)
    np.testing.assert_array_equal(half.correction_deg, [0.05, 0.1, 0.15])
    np.testing.assert_array_equal(half.rate_change_deg_h, [0.0, 1.0, 2.0])


def test_nothing_commanded_costs_nothing(spacecraft):
    nobody = np.zeros(CARRIERS, dtype=bool)
    watch = pass_commands(
        spacecraft.model, SETTINGS, executed_commands(), MINUTE_US, no_motion(), nobody, is_raining=False
    )
    assert not watch.sensitivity.any()
    assert not watch.is_doubted
