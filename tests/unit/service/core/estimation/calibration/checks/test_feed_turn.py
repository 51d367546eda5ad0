"""Feed of a polarimeter by quiet days: its turn and daily wave with their sigmas, its leakage by the turns."""

import math

import numpy as np
import pytest

from service.core.estimation.calibration.checks.angle_response import AngleResponse
from service.core.estimation.calibration.checks.feed_turn import feed_leakage, feed_turn
from service.core.estimation.filtering.model.filter_model import PolarimeterModel
from service.core.estimation.filtering.watches.polarimeter_watch import AngleBlock

READ = PolarimeterModel((0.99, -0.07, -0.13))
BLOCK_US, BLOCKS, BLOCK_H = 300_000_000, 864, 1.0 / 12.0
TRUE_DEG = np.array([0.8, 0.03, -0.02])


def blocks(seed: int, moved_deg: float = 0.0, scatter: float = 1.0) -> list[AngleBlock]:
    """Return three days of an offset, a wave, a wander of the stated size and noise; the feed moves after two."""
    rng, at_us = np.random.default_rng(seed), BLOCK_US * np.arange(1, BLOCKS + 1)
    keep = math.exp(-BLOCK_H / READ.wander_h)
    wander = [rng.normal(0.0, READ.wander_deg)]
    for shock in rng.normal(0.0, READ.wander_deg * math.sqrt(1.0 - keep**2), BLOCKS - 1):
        wander.append(keep * wander[-1] + shock)
    phase = 2.0 * math.pi * at_us / 86_400e6
    wave = np.column_stack([np.ones(BLOCKS), np.cos(phase), np.sin(phase)]) @ TRUE_DEG
    angle = wave + np.array(wander) + moved_deg * (at_us > 2 * 86_400e6) + rng.normal(0.0, 0.04 * scatter, BLOCKS)
    told = zip(at_us.tolist(), angle.tolist(), strict=True)
    return [AngleBlock(epoch_us, angle_deg, 0.04**2, -55.0) for epoch_us, angle_deg in told]


def test_offset_and_wave_are_right_within_the_sigmas_that_are_stated() -> None:
    squares = []
    for seed in range(1, 21):
        found = feed_turn(blocks(seed), READ)
        assert found is not None
        off = np.array(found.mean) - TRUE_DEG
        squares.append(off @ np.linalg.solve(np.array(found.covariance), off))
        assert np.sqrt(np.diag(found.covariance)).max() < 0.03
    print("seeds 1 to 20, squares of three", np.round(squares, 1))
    assert 1.5 < float(np.mean(squares)) < 5.0


def test_a_feed_that_moved_on_the_way_is_where_it_stands_at_the_end() -> None:
    found = feed_turn(blocks(1, moved_deg=0.6), READ)
    assert found is not None
    assert found.mean[0] == pytest.approx(TRUE_DEG[0] + 0.6, abs=4.0 * math.sqrt(found.covariance[0][0]))


def test_blocks_that_contradict_one_another_and_none_tell_nothing() -> None:
    assert feed_turn(blocks(1, scatter=8.0), READ) is None
    assert feed_turn([], READ) is None


def test_a_steep_feed_has_its_leakage_by_isolation_and_a_flat_one_by_the_turns() -> None:
    leak = 0.03
    for turn_deg, sigma_deg in ((5.0, 0.7), (45.0, 0.57)):
        slope = 1.0 - leak * math.sin(math.radians(2.0 * turn_deg))
        found = feed_leakage(AngleResponse(slope, 0.0168), turn_deg)
        share = 1.0 - (found.sigma_deg / math.degrees(10.0**-1.75 / math.sqrt(2.0))) ** 2
        assert found.sigma_deg == pytest.approx(sigma_deg, rel=0.05)
        assert found.leakage_deg == pytest.approx(share * math.degrees(leak))
    assert feed_leakage(AngleResponse(math.nan, math.nan), 10.0).leakage_deg == 0.0
