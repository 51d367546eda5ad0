"""Watches of commands, of the polarimeter, of noise, and integrity."""

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.filter_update import innovate, update
from service.core.estimation.filtering.filter_model import (
    FilterSettings,
    Gaussian,
    KnownMotion,
    LearnedFeed,
    PolarimeterModel,
    no_motion,
    pattern_change,
)
from service.core.estimation.filtering.motion_sensor import SensorWatch
from service.core.estimation.filtering.polarimeter import AngleBlock, polarimeter_advice, push_block
from service.core.estimation.filtering.command_watch import (
    CommandWatch,
    believed_motion,
    executed_commands,
    judge_commands,
    likelier_share,
    pass_commands,
    push_row,
)
from service.core.estimation.filtering.integrity import IntegrityInputs, IntegrityLimits, assess, good_figures
from service.core.estimation.filtering.watches.noise_watch import SLOW_LIMITS, calm_watch, push_values

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


READ = PolarimeterModel((1.0, 0.0, 0.0))
FIRST, SIZE, STEP_US = 11, 15, 300_000_000
Judged = tuple[SensorWatch, Gaussian]


def settled():
    """Return the watch and the state after the first angle, 1 deg at a yaw of 0."""
    sigma = [0.1, 0.02, 0.02, *(0.04,) * 3, *(1e-4,) * 3, 0.1, 1e-3, 3.0, 0.05, 0.05, 0.05]
    return pushed((SensorWatch(0), Gaussian(np.zeros(SIZE), np.diag(np.square(sigma)))), 1.0)


def pushed(judged, angle_deg, power_dbm=-55.0, number=None):
    """Return watch and state after a block, five minutes after the one before, in which yaw may have turned."""
    watch, gaussian = judged
    gaussian = Gaussian(gaussian.mean, gaussian.covariance + np.diag([0.05**2, *(0.0,) * (SIZE - 1)]))
    epoch_us = max(watch.newest_us, 0) + STEP_US if number is None else number * STEP_US
    block = AngleBlock(epoch_us, angle_deg, 0.001, power_dbm)
    return push_block(watch, gaussian, FIRST, block, epoch_us, READ)[:2]


def advice(judged):
    return [name for name, stands in polarimeter_advice((judged[0],), judged[0].newest_us).items() if stands]


def test_a_change_of_the_angle_is_one_of_yaw_and_a_wild_one_of_nothing():
    before = settled()
    assert pushed(before, 1.1)[1].mean[0] > 0.02
    wild = pushed(before, 3.0)
    np.testing.assert_array_equal(wild[1].mean, before[1].mean)
    assert wild[0].skipped == 1
    # beyond two sigma the pull grows no more as the angle does
    pull = [pushed(before, 1.0 + change)[1].mean[0] for change in (0.1, 0.2)]
    assert pull[1] < 1.7 * pull[0]


def test_three_blocks_beside_in_quiet_power_are_a_moved_feed():
    judged = settled()
    for _block in range(3):
        judged = pushed(judged, 3.0)
    assert advice(judged) == ["polarimeter_moved"]
    assert judged[1].mean[0] == pytest.approx(0.0, abs=2e-3)
    after = pushed(judged, 3.0)
    assert after[1].mean[FIRST] == pytest.approx(3.0, abs=0.05)
    assert after[1].mean[0] == pytest.approx(0.0, abs=0.01)


def test_a_fade_widens_and_a_deep_one_leaves_the_block_out():
    before = settled()
    quiet, faded, deep = (pushed(before, 1.1, power_dbm)[1].mean[0] for power_dbm in (-55.0, -58.0, -62.0))
    assert quiet > 3.0 * faded > 0.0
    assert deep == pytest.approx(before[1].mean[0], abs=1e-12)
    # a step under a fade is no moved feed
    judged = before
    for _block in range(6):
        judged = pushed(judged, 6.0, -57.0)
    assert advice(judged) == []


def test_a_deep_fade_is_told_after_three_hours_until_the_power_is_back():
    judged = settled()
    for _block in range(36):
        judged = pushed(judged, 1.0, -62.0)
        assert advice(judged) == []
    judged = pushed(judged, 1.0, -62.0)
    assert advice(judged) == ["polarimeter_silent"]
    assert advice(pushed(judged, 1.0)) == []


def test_a_polarimeter_that_never_spoke_is_told_and_a_refused_one_is_not():
    watch = SensorWatch(STEP_US)
    for hours, is_told in ((3.0, False), (3.1, True)):
        epoch_us = STEP_US + round(hours * 3.6e9)
        assert polarimeter_advice((watch,), epoch_us)["polarimeter_silent"] is is_told
        assert not polarimeter_advice((watch._replace(is_refused=True),), epoch_us)["polarimeter_silent"]
    assert not any(polarimeter_advice((), 10**15).values())


def test_blocks_that_are_not_newer_tell_nothing():
    before = settled()
    watch, gaussian = pushed(before, 1.5, number=1)
    assert watch is before[0]
    np.testing.assert_array_equal(gaussian.mean, before[1].mean)


def test_a_polarimeter_that_keeps_disagreeing_is_refused_and_yaw_known_less():
    judged, rng = settled(), np.random.default_rng(1)
    for _block in range(80):
        judged = pushed(judged, 1.0 + float(rng.normal(0.0, 0.6)))
    assert "polarimeter_refused" in advice(judged)
    assert judged[1].covariance[0, 0] >= 0.2**2
    assert pushed(judged, 1.0)[0] is judged[0]


@pytest.mark.parametrize(
    ("moved_deg", "is_free", "is_reported"), [(0.1, False, False), (0.25, True, False), (0.6, True, True)]
)
def test_a_first_angle_off_what_the_calibration_saw_frees_the_offset(moved_deg, is_free, is_reported):
    sigma = [0.02, 0.02, 0.02, *(0.04,) * 3, *(1e-4,) * 3, 0.1, 1e-3, 0.02, 0.03, 0.03, 0.05]
    begun, block = Gaussian(np.zeros(SIZE), np.diag(np.square(sigma))), AngleBlock(STEP_US, moved_deg, 0.002, -55.0)
    learned = READ._replace(learned=LearnedFeed((0.0,) * 3, tuple(map(tuple, np.diag([4e-4, 9e-4, 9e-4]).tolist()))))
    watch, gaussian, _ = push_block(SensorWatch(0), begun, FIRST, block, STEP_US, learned)
    assert advice((watch, gaussian)) == ["polarimeter_moved"] * is_reported
    assert bool(gaussian.mean[FIRST] > 0.9 * moved_deg) is is_free
    # what was learned of the wave was learned of another feed
    assert bool(gaussian.covariance[FIRST + 1, FIRST + 1] > 0.05**2) is is_free
    # without a calibration of the feed nothing of the kind is asked
    free = push_block(SensorWatch(0), begun, FIRST, block, STEP_US, READ)[1]
    assert free.mean[FIRST] < 0.5 * moved_deg


def minute_update(values):
    """Return the watch of a filter whose test values follow the factors: a wider sigma makes them smaller."""
    watch = calm_watch(values.shape[1])
    for row in values:
        tested = row / watch.white_scale
        watch = push_values(watch, tested, float(np.nansum(tested**2)), values.shape[1])
    return watch


def test_what_the_model_says_keeps_the_factors_at_one():
    watch = minute_update(np.random.default_rng(1).standard_normal((3000, 16)))
    assert abs(watch.slow_scale - 1.0) < 0.15  # six hours of memory over sixteen carriers
    assert np.abs(watch.white_scale - 1.0).max() < 0.2
    assert abs(watch.nis_ratio - 1.0) < 0.1


def test_louder_white_noise_raises_its_own_carrier_only():
    values = np.random.default_rng(2).standard_normal((1500, 8))
    values[:, 3] *= 1.8
    watch = minute_update(values)
    assert abs(watch.white_scale[3] - 1.8) < 0.25  # four hours of memory, outliers cut
    assert np.delete(watch.white_scale, 3).max() < 1.25


def test_slow_noise_that_the_model_does_not_know_raises_the_slow_factor():
    rng = np.random.default_rng(3)
    values, slow = rng.standard_normal((1500, 8)), np.zeros(8)
    for row in range(1500):
        slow = 0.98 * slow + 0.1 * rng.standard_normal(8)
        values[row] += slow
    watch = minute_update(values)
    assert watch.slow_scale > 1.5
    assert minute_update(values * 9.0).slow_scale <= SLOW_LIMITS[1]


def test_absent_carriers_teach_nothing():
    values = np.full((50, 4), np.nan)
    watch = calm_watch(4)
    for row in values:
        watch = push_values(watch, row, 4.0, 4)
    assert watch.slow_scale == 1.0
    assert (watch.white_scale == 1.0).all()


SIGMA, LEVEL, STILL = np.array([0.09, 0.01, 0.02]), np.array([0.4, 0.08, 0.12]), np.array([0.05, 0.1, 0.1])
CALM = IntegrityInputs(0, SIGMA, LEVEL, LEVEL, STILL, 16, False, False, 1.0, (False, False, False), 0, 16)
#: a torque turns yaw and pitch
PUSHED = CALM._replace(waiting_loss_deg=np.array([0.9, 0.1, 0.11]))


def judged(evidence):
    return assess(evidence, IntegrityLimits(), good_figures())[0]


def test_a_calm_row_allows_all_axes():
    verdict = judged(CALM)
    assert verdict.is_control_allowed
    assert verdict.is_axis_allowed == (True, True, True)
    assert verdict.reasons == ()
    assert not verdict.is_realignment_advised


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"is_raining": True}, "downlink_fade"),
        ({"is_chain_held": True}, "chain_step"),
        ({"sigma_deg": np.array([0.09, 0.061, 0.02])}, "sigma_roll"),
        ({"sigma_deg": np.array([0.09, 0.01, 0.101])}, "sigma_pitch"),
        ({"sigma_deg": np.array([0.09, 0.01, np.nan])}, "sigma_pitch"),
        ({"protection_deg": np.array([0.4, 0.08, 0.23])}, "protection_level"),
        ({"protection_deg": np.array([0.4, 0.23, 0.12])}, "protection_level"),
        ({"protection_deg": np.array([0.4, np.nan, 0.12])}, "integrity_unmonitored"),
        ({"carriers_used": 5}, "redundancy"),
        ({"nis_ratio": 2.1}, "innovations"),
        ({"is_unannounced": (False, True, False)}, "unannounced_motion"),
        ({"is_command_doubted": True}, "unannounced_motion"),
        ({"has_jumped": True}, "unannounced_motion"),
    ],
)
def test_each_condition_withholds_control_and_says_so(change, reason):
    verdict = judged(CALM._replace(**change))
    assert verdict.reasons == (reason,)
    assert verdict.is_axis_allowed == (False, False, False)


LESS_CERTAIN = [
    {"sigma_deg": np.array([0.5, 0.2, 0.3])},
    {"protection_deg": np.array([0.4, 0.08, 0.23]), "nominal_deg": np.array([0.4, 0.08, 0.16])},
    {"is_unannounced": (True, True, True)},
]
WRONG_IN_KIND = [
    {"is_raining": True},
    {"is_chain_held": True},
    {"protection_deg": np.array([0.4, 0.08, 0.25]), "nominal_deg": np.array([0.4, 0.08, 0.16])},
    {"protection_deg": np.array([0.4, np.nan, 0.12])},
    {"carriers_used": 5},
    {"nis_ratio": 2.1},
    {"is_command_doubted": True},
    {"has_jumped": True},
]


@pytest.mark.parametrize("change", LESS_CERTAIN)
def test_less_certain_is_used_where_something_is_lost_by_waiting(change):
    assert judged(PUSHED._replace(**change)).is_axis_allowed == (True, True, True)


@pytest.mark.parametrize("change", WRONG_IN_KIND)
def test_wrong_in_kind_is_not_used_whatever_is_lost(change):
    assert judged(PUSHED._replace(**change)).is_axis_allowed == (False, False, False)


def test_a_figure_that_passed_its_limit_inhibits_for_ten_minutes():
    def of_levels(levels_deg):
        until, allowed = good_figures(), []
        for minute, level in enumerate(levels_deg):
            row = CALM._replace(epoch_us=minute * MINUTE_US, protection_deg=np.array([0.4, 0.08, level]))
            verdict, until = assess(row, IntegrityLimits(), until)
            allowed.append(verdict.is_control_allowed)
        return allowed

    assert of_levels([0.21, 0.23, *[0.17] * 12]) == [True] + [False] * 10 + [True] * 3
    # what flickers about its limit changes once
    assert of_levels([0.23, 0.21] * 20) == [False] * 40


@pytest.mark.parametrize(
    "change", [{"sigma_deg": np.array([0.14, 0.01, 0.02])}, {"is_unannounced": (True, False, False)}]
)
def test_yaw_alone_may_be_withheld(change):
    verdict = judged(CALM._replace(**change))
    assert verdict.is_control_allowed
    assert verdict.is_axis_allowed == (False, True, True)
    assert judged(PUSHED._replace(**change)).is_axis_allowed == (True, True, True)


def test_a_third_of_the_references_learned_anew_advises_an_alignment():
    assert not judged(CALM._replace(relearned=5)).is_realignment_advised
    assert judged(CALM._replace(relearned=6)).is_realignment_advised
