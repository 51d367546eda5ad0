"""Commands watched: obeyed, lost, turned round; what their evidence is made of."""

import filter_models
import numpy as np
import pytest
from filter_rows import step

from service.core.estimation.filtering.command_watch import (
    DOUBTED_MINUTES,
    judge_commands,
    likelier_share,
    pass_commands,
    push_row,
)
from service.core.estimation.filtering.filter_model import KnownMotion, no_motion, pattern_change
from service.core.estimation.filtering.filter_state import initial_watch, start
from service.core.estimation.filtering.motion import step_motion
from service.core.estimation.filtering.plant import filter_model
from service.core.estimation.filtering.prediction import decay_factors

MINUTE_US = 60_000_000
CARRIERS = 16
ZEROS = np.zeros(3)


class OrbitalFrameSpacecraft:
    """A spacecraft without drift that carries out a share of what is commanded."""

    def __init__(self):
        self.model, self.rng = filter_models.carrier_model(carriers=CARRIERS), np.random.default_rng(8)
        self.compiled = filter_model(self.model)
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
        self.announced.append(step(self.compiled, self.state, self.state.epoch_us + MINUTE_US, row, known))
        self.state = self.announced[-1].state

    @property
    def doubted(self):
        return [row.state.watch["doubted_minutes"][0] > 0.0 for row in self.announced]


@pytest.fixture
def spacecraft():
    return OrbitalFrameSpacecraft()


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
    assert spacecraft.state.watch["share"][0] == share
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
    assert spacecraft.state.watch["share"][0] == share
    assert abs(spacecraft.announced[-1].attitude_deg[2] - spacecraft.attitude_deg[2]) < 0.05


def test_a_doubt_ends_after_an_hour(spacecraft):
    spacecraft.turn(30, 0.0, 1.0)
    spacecraft.turn(45, 0.004, -1.0)
    announced = spacecraft.turn(75, 0.0, 1.0)
    assert not announced.state.watch["doubted_minutes"][0]
    assert announced.state.watch["share"][0] == 1.0


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=CARRIERS)


def begun(model):
    return start(model, 0, filter_models.aligned(model))


def commanded(model, state, known, step_us=MINUTE_US):
    """Let a step with commands pass for the watch alone; the state stands where it was."""
    compiled, after = filter_model(model), filter_models.copied(state)
    still = np.zeros(3, dtype=bool)
    moved = known.correction_deg, known.late_correction_deg, known.rate_change_deg_h
    motion = step_motion(compiled, 0, known.unreported, 0, step_us, *moved, 1.0, np.nan, still, False)
    factor, _ = decay_factors(compiled, after, step_us / 1e6, 0)
    moved = known.correction_deg, known.rate_change_deg_h
    pass_commands(compiled, after, motion.transition, factor, *moved, step_us)
    return after


def pushed(model, state, row_db, *, is_shared=False):
    """Return the state after an update of which the watch knows, and what was used."""
    compiled = filter_model(model)
    used = filter_models.innovated(compiled, state.gaussian, row_db)
    after = filter_models.updated(compiled, state, row_db, used).state
    push_row(compiled, after, used, is_shared)
    return after, used


def test_a_row_that_something_else_moved_says_nothing_about_commands(model):
    state = commanded(model, begun(model), KnownMotion(np.array([0.0, 0.1, 0.1]), ZEROS, ZEROS))
    row_db = np.full(CARRIERS, 0.3)
    shared, own = (pushed(model, state, row_db, is_shared=is_shared)[0] for is_shared in (True, False))
    assert not shared.watch["score"].any()
    assert not shared.watch["information"].any()
    assert own.watch["information"][0, 0, 0] > 0.0
    np.testing.assert_array_equal(own.sensitivity, shared.sensitivity)


def test_sums_are_those_of_the_innovations_covariance(model):
    """Score and information without an inverse are the ones with it."""
    state = commanded(model, begun(model), KnownMotion(np.array([0.05, 0.1, -0.1]), ZEROS, ZEROS))
    after, used = pushed(model, state, np.random.default_rng(8).normal(0.0, 0.05, CARRIERS))
    seen = used.core_jacobian[:, :3] @ state.sensitivity[:3]
    whitened = np.linalg.solve(used.predicted_db2 + np.diag(used.white_db2), seen)
    # rounding of the sums; the attitude at an alignment is known to 0.005 deg
    np.testing.assert_allclose(after.watch["score"][0], whitened.T @ used.innovation_db, rtol=1e-6)
    np.testing.assert_allclose(after.watch["information"][0], whitened.T @ seen, rtol=1e-6)


def with_evidence(score, information, score_yaw=0.0, cross=0.0, information_yaw=0.0):
    watch = initial_watch(0)
    watch["score"], watch["information"] = (score, score_yaw), [[information, cross], [cross, information_yaw]]
    return watch[0]


def test_the_likeliest_share_needs_evidence():
    assert likelier_share(with_evidence(-20.0, 20.0)) == 0.0
    assert np.isnan(likelier_share(with_evidence(-4.0, 4.0)))
    assert likelier_share(with_evidence(-20.0, 10.0)) == -1.0


def test_what_a_turn_of_yaw_explains_is_not_held_against_commands():
    assert np.isnan(likelier_share(with_evidence(-20.0, 20.0, -40.0, 40.0, 80.0)))
    assert likelier_share(with_evidence(-20.0, 20.0, 0.0, 0.0, 80.0)) == 0.0


@pytest.mark.parametrize(("reach_deg", "is_believed"), [(0.4, True), (0.6, False)])
def test_a_share_moves_the_attitude_by_half_a_degree_at_most(model, reach_deg, is_believed):
    """Beyond it the first order does not hold: control is told, the state stays."""
    before = begun(model)
    after = filter_models.copied(before).with_watch(score=(-20.0, 0.0), information=[[20.0, 0.0], [0.0, 0.0]])
    after.sensitivity[1, 0] = reach_deg
    judge_commands(after)
    assert after.watch["doubted_minutes"][0] == DOUBTED_MINUTES
    assert after.watch["share"][0] == (0.0 if is_believed else 1.0)
    assert after.mean[1] - before.mean[1] == pytest.approx(-reach_deg if is_believed else 0.0)
    assert not after.sensitivity.any()


def test_a_believed_share_scales_the_commands(model):
    known = KnownMotion(np.array([0.1, 0.2, 0.3]), ZEROS, np.array([0.0, 2.0, 4.0]))
    half = begun(model).with_watch(share=0.5, doubted_minutes=9.0)
    moved = filter_models.coasted(filter_model(model), half, MINUTE_US, known)
    halved = known._replace(correction_deg=0.5 * known.correction_deg, rate_change_deg_h=0.5 * known.rate_change_deg_h)
    expected = filter_models.coasted(filter_model(model), begun(model), MINUTE_US, halved)
    np.testing.assert_array_equal(moved.mean, expected.mean)
    # the watch asks about whole commands
    np.testing.assert_allclose(moved.sensitivity[:3, 0], 2.0 * expected.sensitivity[:3, 0])


def test_nothing_commanded_costs_nothing(model):
    watched = commanded(model, begun(model), no_motion())
    assert not watched.sensitivity.any()
    assert watched.watch["doubted_minutes"][0] == 0.0


def test_carriers_that_are_out_have_no_part_in_the_evidence(model):
    state = begun(model).with_carriers(is_flagged=np.arange(CARRIERS) == 4)
    state.sensitivity[:] = 1.0
    after = commanded(model, state, no_motion())
    assert not after.sensitivity[-3 * CARRIERS + 4 :: CARRIERS].any()
    assert after.sensitivity[-3 * CARRIERS + 5 :: CARRIERS].all()
