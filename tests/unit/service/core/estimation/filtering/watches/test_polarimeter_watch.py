"""Judgement of a polarimeter: what is taken, what counts less, a moved feed, rain and a refusal."""

import numpy as np
import pytest

from service.core.estimation.filtering.model.filter_model import LearnedFeed, PolarimeterModel
from service.core.estimation.filtering.model.filter_state import Gaussian
from service.core.estimation.filtering.watches.polarimeter_watch import (
    AngleBlock,
    PolarimeterWatch,
    polarimeter_advice,
    push_block,
)

READ = PolarimeterModel((1.0, 0.0, 0.0))
FIRST, SIZE, STEP_US = 11, 15, 300_000_000
Judged = tuple[PolarimeterWatch, Gaussian]


def settled() -> Judged:
    """Return the watch and the state after the first angle, 1 deg at a yaw of 0."""
    sigma = [0.1, 0.02, 0.02, *(0.04,) * 3, *(1e-4,) * 3, 0.1, 1e-3, 3.0, 0.05, 0.05, 0.05]
    return pushed((PolarimeterWatch(0), Gaussian(np.zeros(SIZE), np.diag(np.square(sigma)))), 1.0)


def pushed(judged: Judged, angle_deg: float, power_dbm: float = -55.0, number: int | None = None) -> Judged:
    """Return watch and state after a block, five minutes after the one before, in which yaw may have turned."""
    watch, gaussian = judged
    gaussian = Gaussian(gaussian.mean, gaussian.covariance + np.diag([0.05**2, *(0.0,) * (SIZE - 1)]))
    epoch_us = max(watch.newest_us, 0) + STEP_US if number is None else number * STEP_US
    block = AngleBlock(epoch_us, angle_deg, 0.001, power_dbm)
    return push_block(watch, gaussian, FIRST, block, epoch_us, READ)[:2]


def advice(judged: Judged) -> list[str]:
    return [name for name, stands in polarimeter_advice((judged[0],), judged[0].newest_us).items() if stands]


def test_a_change_of_the_angle_is_one_of_yaw_and_a_wild_one_of_nothing() -> None:
    before = settled()
    assert pushed(before, 1.1)[1].mean[0] > 0.02
    wild = pushed(before, 3.0)
    np.testing.assert_array_equal(wild[1].mean, before[1].mean)
    assert wild[0].skipped == 1
    # beyond two sigma the pull grows no more as the angle does
    pull = [pushed(before, 1.0 + change)[1].mean[0] for change in (0.1, 0.2)]
    assert pull[1] < 1.7 * pull[0]


def test_three_blocks_beside_in_quiet_power_are_a_moved_feed() -> None:
    judged = settled()
    for _block in range(3):
        judged = pushed(judged, 3.0)
    assert advice(judged) == ["polarimeter_moved"]
    assert judged[1].mean[0] == pytest.approx(0.0, abs=2e-3)
    after = pushed(judged, 3.0)
    assert after[1].mean[FIRST] == pytest.approx(3.0, abs=0.05)
    assert after[1].mean[0] == pytest.approx(0.0, abs=0.01)


def test_a_fade_widens_and_a_deep_one_leaves_the_block_out() -> None:
    before = settled()
    quiet, faded, deep = (pushed(before, 1.1, power_dbm)[1].mean[0] for power_dbm in (-55.0, -58.0, -62.0))
    assert quiet > 3.0 * faded > 0.0
    assert deep == pytest.approx(before[1].mean[0], abs=1e-12)
    # a step under a fade is no moved feed
    judged = before
    for _block in range(6):
        judged = pushed(judged, 6.0, -57.0)
    assert advice(judged) == []


def test_a_deep_fade_is_told_after_three_hours_until_the_power_is_back() -> None:
    judged = settled()
    for _block in range(36):
        judged = pushed(judged, 1.0, -62.0)
        assert advice(judged) == []
    judged = pushed(judged, 1.0, -62.0)
    assert advice(judged) == ["polarimeter_silent"]
    assert advice(pushed(judged, 1.0)) == []


def test_a_polarimeter_that_never_spoke_is_told_and_a_refused_one_is_not() -> None:
    watch = PolarimeterWatch(STEP_US)
    for hours, is_told in ((3.0, False), (3.1, True)):
        epoch_us = STEP_US + round(hours * 3.6e9)
        assert polarimeter_advice((watch,), epoch_us)["polarimeter_silent"] is is_told
        assert not polarimeter_advice((watch._replace(is_refused=True),), epoch_us)["polarimeter_silent"]
    assert not any(polarimeter_advice((), 10**15).values())


def test_blocks_that_are_not_newer_tell_nothing() -> None:
    before = settled()
    watch, gaussian = pushed(before, 1.5, number=1)
    assert watch is before[0]
    np.testing.assert_array_equal(gaussian.mean, before[1].mean)


def test_a_polarimeter_that_keeps_disagreeing_is_refused_and_yaw_known_less() -> None:
    judged, rng = settled(), np.random.default_rng(1)
    for _block in range(80):
        judged = pushed(judged, 1.0 + float(rng.normal(0.0, 0.6)))
    assert "polarimeter_refused" in advice(judged)
    assert judged[1].covariance[0, 0] >= 0.2**2
    assert pushed(judged, 1.0)[0] is judged[0]


@pytest.mark.parametrize(
    ("moved_deg", "is_free", "is_reported"), [(0.1, False, False), (0.25, True, False), (0.6, True, True)]
)
def test_a_first_angle_off_what_the_calibration_saw_frees_the_offset(
    moved_deg: float, is_free: bool, is_reported: bool
) -> None:
    sigma = [0.02, 0.02, 0.02, *(0.04,) * 3, *(1e-4,) * 3, 0.1, 1e-3, 0.02, 0.03, 0.03, 0.05]
    begun, block = Gaussian(np.zeros(SIZE), np.diag(np.square(sigma))), AngleBlock(STEP_US, moved_deg, 0.002, -55.0)
    learned = READ._replace(learned=LearnedFeed((0.0,) * 3, tuple(map(tuple, np.diag([4e-4, 9e-4, 9e-4]).tolist()))))
    watch, gaussian, _ = push_block(PolarimeterWatch(0), begun, FIRST, block, STEP_US, learned)
    assert advice((watch, gaussian)) == ["polarimeter_moved"] * is_reported
    assert bool(gaussian.mean[FIRST] > 0.9 * moved_deg) is is_free
    # what was learned of the wave was learned of another feed
    assert bool(gaussian.covariance[FIRST + 1, FIRST + 1] > 0.05**2) is is_free
    # without a calibration of the feed nothing of the kind is asked
    free = push_block(PolarimeterWatch(0), begun, FIRST, block, STEP_US, READ)[1]
    assert free.mean[FIRST] < 0.5 * moved_deg
