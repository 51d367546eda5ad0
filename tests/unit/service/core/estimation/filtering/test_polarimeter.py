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
from service.core.estimation.filtering.filter_state import initial_sensors
from service.core.estimation.filtering.motion import hidden_decay
from service.core.estimation.filtering.motion_sensor import JUMPED, REFUSED, SILENT, sensor_advice, use_record
from service.core.estimation.filtering.plant import POLARIMETER, filter_model, momentum_count, sensor_states
from service.core.estimation.filtering.polarimeter import (
    AngleBlock,
    angle_deg,
    compare_angle,
    polarimeter_covariance,
    push_angle,
    ratio_db,
    slope_db_deg,
    with_learned_feeds,
)

HOUR_US, STEP_US = 3_600_000_000, 300_000_000
READ = PolarimeterModel((0.99, -0.09, -0.13))
#: nine core states, chain and rain, four of the polarimeter
FIRST, SIZE = 11, 15


def feed_of(polarimeter):
    return filter_model(no_carriers(), FilterSettings(polarimeters=(polarimeter,))).feeds[0]


FEED = feed_of(READ)


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
    block = AngleBlock(epoch_us + round(after_h * HOUR_US), expected + 0.2, 0.01, math.nan)
    found = compare_angle(FEED, *read_state(), FIRST, block, 0.0, epoch_us)
    assert found.innovation[0] == pytest.approx(0.2)
    assert found.covariance[0, 0] == pytest.approx(
        float(found.cross[0, :3] @ np.array(READ.sight)) + 9.0 + 0.005 + 0.01, abs=1e-4
    )


def used(gaussian, measured_deg, variance_deg2):
    """Return the state after an angle that is believed."""
    gaussian = Gaussian(*(each.copy() for each in gaussian))
    found = compare_angle(FEED, *gaussian, FIRST, AngleBlock(0, measured_deg, variance_deg2, math.nan), 0.0, 0)
    use_record(*gaussian, found, 0.0, np.zeros((0, 0)))
    return gaussian


def test_a_first_angle_sets_the_offset_and_leaves_yaw():
    before = read_state()
    after = used(before, 2.0, 0.005)
    assert after.mean[0] == pytest.approx(before.mean[0], abs=2e-3)
    assert after.covariance[0, 0] == pytest.approx(before.covariance[0, 0], rel=2e-3)
    # a change is of yaw, as far as the wander allows: 0.1 deg of yaw beside some hundredths
    again = used(after, 2.1, 0.0005)
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


def settled():
    """Return the watch and the state after the first angle, 1 deg at a yaw of 0."""
    sigma = [0.1, 0.02, 0.02, *(0.04,) * 3, *(1e-4,) * 3, 0.1, 1e-3, 3.0, 0.05, 0.05, 0.05]
    return pushed((initial_sensors(1, 0)[1:], Gaussian(np.zeros(SIZE), np.diag(np.square(sigma)))), 1.0)


def pushed(judged, angle_deg, power_dbm=-55.0, number=None):
    """Return watch and state after a block, five minutes after the one before, in which yaw may have turned."""
    watch, gaussian = judged
    gaussian = Gaussian(gaussian.mean, gaussian.covariance + np.diag([0.05**2, *(0.0,) * (SIZE - 1)]))
    epoch_us = max(int(watch["newest_us"][0]), 0) + STEP_US if number is None else number * STEP_US
    return taken(watch, gaussian, AngleBlock(epoch_us, angle_deg, 0.001, power_dbm), YAWED)


def taken(watch, gaussian, block, polarimeter):
    """Return watch and state after a block of now, those given as they were."""
    watch, gaussian = watch.copy(), Gaussian(*(each.copy() for each in gaussian))
    push_angle(feed_of(polarimeter), watch[0], *gaussian, FIRST, block, block.epoch_us, np.zeros((0, 0)))
    return watch, gaussian


def told(watches, epoch_us):
    advised = sensor_advice(watches, epoch_us)
    return [name for name, bit in (("refused", REFUSED), ("moved", JUMPED), ("silent", SILENT)) if advised & bit]


def advice(judged):
    return told(judged[0], int(judged[0]["newest_us"][0]))


def test_a_change_of_the_angle_is_one_of_yaw_and_a_wild_one_of_nothing():
    before = settled()
    assert pushed(before, 1.1)[1].mean[0] > 0.02
    wild = pushed(before, 3.0)
    np.testing.assert_array_equal(wild[1].mean, before[1].mean)
    assert wild[0]["skipped"][0] == 1
    # beyond two sigma the pull grows no more as the angle does
    pull = [pushed(before, 1.0 + change)[1].mean[0] for change in (0.1, 0.2)]
    assert pull[1] < 1.7 * pull[0]


def test_three_blocks_beside_in_quiet_power_are_a_moved_feed():
    judged = settled()
    for _block in range(3):
        judged = pushed(judged, 3.0)
    assert advice(judged) == ["moved"]
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
    assert advice(judged) == ["silent"]
    assert advice(pushed(judged, 1.0)) == []


def test_a_polarimeter_that_never_spoke_is_told_and_a_refused_one_is_not():
    watch = initial_sensors(1, STEP_US)[1:]
    refused = watch.copy()
    refused["is_refused"] = True
    for hours, is_told in ((3.0, False), (3.1, True)):
        epoch_us = STEP_US + round(hours * 3.6e9)
        assert told(watch, epoch_us) == ["silent"] * is_told
        assert told(refused, epoch_us) == ["refused"]
    assert told(watch[:0], 10**15) == []


def test_blocks_that_are_not_newer_tell_nothing():
    before = settled()
    watch, gaussian = pushed(before, 1.5, number=1)
    assert repr(watch) == repr(before[0])
    np.testing.assert_array_equal(gaussian.mean, before[1].mean)


def test_a_polarimeter_that_keeps_disagreeing_is_refused_and_yaw_known_less():
    judged, rng = settled(), np.random.default_rng(1)
    for _block in range(80):
        judged = pushed(judged, 1.0 + float(rng.normal(0.0, 0.6)))
    assert "refused" in advice(judged)
    assert judged[1].covariance[0, 0] >= 0.2**2
    assert repr(pushed(judged, 1.0)[0]) == repr(judged[0])


@pytest.mark.parametrize(
    ("moved_deg", "is_free", "is_reported"), [(0.1, False, False), (0.25, True, False), (0.6, True, True)]
)
def test_a_first_angle_off_what_the_calibration_saw_frees_the_offset(moved_deg, is_free, is_reported):
    sigma = [0.02, 0.02, 0.02, *(0.04,) * 3, *(1e-4,) * 3, 0.1, 1e-3, 0.02, 0.03, 0.03, 0.05]
    begun, block = Gaussian(np.zeros(SIZE), np.diag(np.square(sigma))), AngleBlock(STEP_US, moved_deg, 0.002, -55.0)
    learned = YAWED._replace(learned=LearnedFeed((0.0,) * 3, tuple(map(tuple, np.diag([4e-4, 9e-4, 9e-4]).tolist()))))
    watch, gaussian = taken(initial_sensors(1, 0)[1:], begun, block, learned)
    assert advice((watch, gaussian)) == ["moved"] * is_reported
    assert bool(gaussian.mean[FIRST] > 0.9 * moved_deg) is is_free
    # what was learned of the wave was learned of another feed
    assert bool(gaussian.covariance[FIRST + 1, FIRST + 1] > 0.05**2) is is_free
    # without a calibration of the feed nothing of the kind is asked
    free = taken(initial_sensors(1, 0)[1:], begun, block, YAWED)[1]
    assert free.mean[FIRST] < 0.5 * moved_deg
