"""Allan deviation of levels: white noise averages, drifts do not, gaps and thin spans are not read."""

import numpy as np
import pytest

from service.core.estimation.noise.allan import allan_deviation_db

EPOCHS_S = 60.0 * np.arange(4320)


def test_white_noise_falls_with_the_root_of_the_span() -> None:
    level = np.random.default_rng(1).normal(0.0, 0.2, (4320, 3))
    found = allan_deviation_db(level, EPOCHS_S, np.array([60.0, 240.0, 960.0]))
    # 270 means of 16 rows know their scatter to 4 %
    assert found == pytest.approx(0.2 / np.sqrt([[1.0], [4.0], [16.0]]) * np.ones((1, 3)), rel=0.15)


def test_a_drift_is_its_slope_times_the_span() -> None:
    found = allan_deviation_db((EPOCHS_S / 3600.0)[:, np.newaxis], EPOCHS_S, np.array([3600.0]))
    assert found[0, 0] == pytest.approx(1.0 / np.sqrt(2.0))


def test_gaps_are_no_noise() -> None:
    level = np.random.default_rng(2).normal(0.0, 0.2, (4320, 1))
    level[2000:] += 5.0
    whole = np.where((EPOCHS_S[:, np.newaxis] > 115_000.0) & (EPOCHS_S[:, np.newaxis] < 125_000.0), np.nan, level)
    # the step lies within the gap, and no pair of means reaches across it
    assert allan_deviation_db(whole, EPOCHS_S, np.array([3600.0]))[0, 0] < 0.06
    assert allan_deviation_db(level, EPOCHS_S, np.array([3600.0]))[0, 0] > 0.3


def test_too_little_says_nothing() -> None:
    spans = np.array([30.0, 60.0, 86_400.0])
    found = allan_deviation_db(np.zeros((4320, 1)), EPOCHS_S, spans)[:, 0]
    assert np.isnan(found).tolist() == [True, False, True], "rows are a minute apart, three days have two pairs"
    assert np.isnan(allan_deviation_db(np.full((10, 1), np.nan), EPOCHS_S[:10], spans)).all()
    assert np.isnan(allan_deviation_db(np.zeros((0, 2)), np.zeros(0), spans)).all()
