"""Polarimeter: its angle against the state, blocks that tell of yaw, of rain, of a moved feed."""

import math

import numpy as np
import pytest

from service.core.estimation.filtering.filter_model import (
    FilterSettings,
    Gaussian,
    LearnedFeed,
    MomentumModel,
    PolarimeterModel,
    no_carriers,
)
from service.core.estimation.filtering.motion import hidden_decay
from service.core.estimation.filtering.motion_sensor import SensorWatch
from service.core.estimation.filtering.plant import POLARIMETER, filter_model, momentum_count, sensor_states
from service.core.estimation.filtering.polarimeter import (
    AngleBlock,
    angle_deg,
    compared_angle,
    polarimeter_advice,
    polarimeter_covariance,
    push_block,
    ratio_db,
    slope_db_deg,
    with_learned_feeds,
)

HOUR_US, STEP_US = 3_600_000_000, 300_000_000
READ = PolarimeterModel((0.99, -0.09, -0.13))
#: nine core states, chain and rain, four of the polarimeter
FIRST, SIZE = 11, 15


def read_state():
    mean = np.zeros(SIZE)
    mean[:3], mean[3:6] = (0.1, -0.02, 0.03), (0.04, -0.02, 0.01)
    mean[FIRST:] = (1.0, 0.02, -0.03, 0.04)
    sigma = [0.1, 0.02, 0.02, *(0.04,) * 3, *(1e-4,) * 3, 0.1, 1e-3, 3.0, 0.05, 0.05, 0.05]
    return Gaussian(mean, np.diag(np.square(sigma)))


@pytest.mark.parametrize("feed_deg", [2.0, 10.0, 45.0, -10.0])
def test_the_slope_is_the_derivative_of_the_ratio(feed_deg):
    step = 1e-5
    slope = (ratio_db(feed_deg, step) - ratio_db(feed_deg, -step)) / (2.0 * step)
    assert slope_db_deg(feed_deg) == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("leakage_deg", [-1.0, 0.4, 1.0])
def test_a_leakage_of_35_db_is_an_offset_and_leaves_the_slope_right_to_a_percent(leakage_deg):
    leak = math.radians(leakage_deg)
    still, turned = (angle_deg(10.0, ratio_db(10.0, turn, leak)) for turn in (0.0, 0.5))
    assert turned - still == pytest.approx(0.5, rel=0.01)
    assert still == pytest.approx(leakage_deg, rel=0.04)


@pytest.mark.parametrize(("epoch_h", "after_h"), [(0.0, 0.0), (5.0, -0.1)])
def test_the_measurement_follows_attitude_and_its_own_states(epoch_h, after_h):
    epoch_us = round(epoch_h * HOUR_US)
    phase = math.radians(15.0 * epoch_h)
    mean = read_state().mean
    then = mean[:3] + after_h * mean[3:6]
    expected = then @ np.array(READ.sight) + 1.04 + 0.02 * math.cos(phase) - 0.03 * math.sin(phase)
    found = compared_angle(read_state(), FIRST, expected + 0.2, 0.01, epoch_us, after_h, READ)
    assert found.innovation[0] == pytest.approx(0.2)
    assert found.covariance[0, 0] == pytest.approx(
        float(found.cross[0, :3] @ np.array(READ.sight)) + 9.0 + 0.005 + 0.01, abs=1e-4
    )


def test_a_first_angle_sets_the_offset_and_leaves_yaw():
    before = read_state()
    found = compared_angle(before, FIRST, 2.0, 0.005, 0, 0.0, READ)
    after = found.applied(before)
    assert after.mean[0] == pytest.approx(before.mean[0], abs=2e-3)
    assert after.covariance[0, 0] == pytest.approx(before.covariance[0, 0], rel=2e-3)
    # a change is of yaw, as far as the wander allows: 0.1 deg of yaw beside some hundredths
    again = compared_angle(after, FIRST, 2.1, 0.0005, 0, 0.0, READ).applied(after)
    assert again.covariance[0, 0] < after.covariance[0, 0]
    np.testing.assert_array_equal(again.covariance, again.covariance.T)


def test_states_of_polarimeters_stand_behind_those_of_the_wheels_and_only_the_wander_decays():
    wheels = MomentumModel(0.01, 0.005, 0.05, (2600.0, 2600.0, 1400.0))
    settings = FilterSettings(momentum=wheels, polarimeters=(READ, READ._replace(wander_deg=0.1, wander_h=2.0)))
    sensors = sensor_states(settings)
    own = momentum_count(settings)
    assert sensors == own + 2 * POLARIMETER
    # eleven states of wheels and one instrument are no torque
    factor, variance = hidden_decay(filter_model(no_carriers(), settings), 2 + sensors, 2, 3600.0)
    wander = [2 + own + 3, 2 + own + 7]
    np.testing.assert_array_equal(np.flatnonzero(variance), wander)
    np.testing.assert_array_equal(np.flatnonzero(factor < 1.0), wander)
    np.testing.assert_allclose(factor[wander], np.exp([-0.25, -0.5]))
    np.testing.assert_allclose(variance[wander], np.square([0.05, 0.1]) * (1.0 - factor[wander] ** 2))
    assert polarimeter_covariance(settings).diagonal()[[3, 7]] == pytest.approx([0.05**2, 0.1**2])


def test_a_filter_begins_with_what_quiet_days_told_of_each_feed():
    told = LearnedFeed((0.6, 0.02, -0.01), ((4e-4, 1e-5, 0.0), (1e-5, 1e-4, 0.0), (0.0, 0.0, 1e-4)))
    settings = FilterSettings(polarimeters=(READ, READ._replace(learned=told)))
    covariance = polarimeter_covariance(settings)
    begun = with_learned_feeds(Gaussian(np.zeros(8), covariance), 0, settings)
    np.testing.assert_array_equal(begun.mean, [0.0, 0.0, 0.0, 0.0, 0.6, 0.02, -0.01, 0.0])
    np.testing.assert_array_equal(begun.covariance[4:7, 4:7], told.covariance)
    np.testing.assert_array_equal(begun.covariance[:4, :4], covariance[:4, :4])
    assert begun.covariance[7, 7] == covariance[7, 7]
    unknown = Gaussian(np.zeros(4), covariance[:4, :4])
    assert with_learned_feeds(unknown, 0, FilterSettings(polarimeters=(READ,))) is unknown


YAWED = PolarimeterModel((1.0, 0.0, 0.0))
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
    return push_block(watch, gaussian, FIRST, block, epoch_us, YAWED)[:2]


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
    learned = YAWED._replace(learned=LearnedFeed((0.0,) * 3, tuple(map(tuple, np.diag([4e-4, 9e-4, 9e-4]).tolist()))))
    watch, gaussian, _ = push_block(SensorWatch(0), begun, FIRST, block, STEP_US, learned)
    assert advice((watch, gaussian)) == ["polarimeter_moved"] * is_reported
    assert bool(gaussian.mean[FIRST] > 0.9 * moved_deg) is is_free
    # what was learned of the wave was learned of another feed
    assert bool(gaussian.covariance[FIRST + 1, FIRST + 1] > 0.05**2) is is_free
    # without a calibration of the feed nothing of the kind is asked
    free = push_block(SensorWatch(0), begun, FIRST, block, STEP_US, YAWED)[1]
    assert free.mean[FIRST] < 0.5 * moved_deg
