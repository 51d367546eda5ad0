"""Trimmed start: blocks of outliers up to 45 per cent, degenerate columns, too few samples."""

import numpy as np
import pytest

from service.core.estimation.calibration.trimmed_start import spread_sets, trimmed_fit

SEED = 8


@pytest.mark.parametrize("share", [0.0, 0.2, 0.45])
def test_a_block_of_outliers_does_not_move_level_and_harmonic(share):
    """Three dB on one stretch: level and amplitude stay within 0.03 dB (acceptance test 2)."""
    rng = np.random.default_rng(SEED)
    phase = np.linspace(0.0, 6.0 * np.pi, 430)
    columns = np.stack([np.ones_like(phase), np.cos(phase), np.sin(phase)], axis=-1)
    values = columns @ [0.2, 0.3, -0.1] + 0.05 * rng.normal(size=430)
    values[40 : 40 + int(share * 430)] -= 3.0
    fit = trimmed_fit(columns[None], values[None], np.ones((1, 430), dtype=bool))[0]
    print(f"seed {SEED}, {share:.0%}: error {fit - [0.2, 0.3, -0.1]}")
    assert fit == pytest.approx([0.2, 0.3, -0.1], abs=0.03)


def test_absent_samples_and_carriers():
    """A carrier with fewer samples than coefficients is zero; absent samples change nothing."""
    columns = np.stack([np.ones(30), np.arange(30.0)], axis=-1)
    values = np.tile(columns @ [1.0, 2.0], (2, 1))
    is_present = np.ones((2, 30), dtype=bool)
    is_present[0, 2:], is_present[1, 5:9] = False, False
    values[1, 5:9] = 1e6
    fit = trimmed_fit(np.tile(columns, (2, 1, 1)), values, is_present)
    assert fit[0].tolist() == [0.0, 0.0]
    assert fit[1] == pytest.approx([1.0, 2.0], abs=1e-3)  # the pull of 1e-6 towards zero


def test_a_column_of_zeros_is_survived():
    """An axis that was not turned."""
    columns = np.stack([np.ones(40), np.zeros(40)], axis=-1)
    fit = trimmed_fit(columns[None], np.full((1, 40), 3.0), np.ones((1, 40), dtype=bool))
    assert fit[0] == pytest.approx([3.0, 0.0], abs=1e-3)  # the pull of 1e-6 towards zero


def test_sets_fill_the_samples():
    """Every tenth of the samples is met about as often as any other."""
    sets = spread_sets(1000, 6, 80)
    share = np.histogram(sets, bins=10, range=(0, 1000))[0] / sets.size
    assert sets.min() >= 0
    assert sets.max() < 1000
    assert share == pytest.approx(np.full(10, 0.1), abs=0.02)  # chance would scatter by 0.014
