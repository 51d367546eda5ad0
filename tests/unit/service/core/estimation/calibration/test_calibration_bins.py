"""Thinning of rows: stretches, means over samples present, impulses."""

import numpy as np
import pytest

from service.core.estimation.calibration.calibration_bins import still_stretches, stretch_means

SEED = 4


def test_stretches_end_with_time_and_with_every_axis():
    """600 s, and 0.06 deg of roll or pitch, and 0.12 deg of yaw."""
    epoch_s = np.arange(40) * 60.0
    angles = np.zeros((40, 3))
    angles[10:, 1], angles[15:, 2], angles[18:, 0] = 0.07, -0.07, 0.13
    stretches = still_stretches(epoch_s, angles, 600.0)
    assert stretches.rows[:, 0].tolist() == [0, 10, 15, 18, 28, 38]
    assert stretches.is_filled.sum(axis=1).tolist() == [10, 5, 3, 10, 10, 2]


def test_rows_without_attitude_belong_to_none():
    """NaN in one angle leaves the row out; without any row there is no stretch."""
    angles = np.zeros((5, 3))
    angles[2, 1] = np.nan
    stretches = still_stretches(np.arange(5) * 60.0, angles, 600.0)
    assert stretches.rows[stretches.is_filled].tolist() == [0, 1, 3, 4]
    nothing = still_stretches(np.arange(5.0), np.full((5, 3), np.nan), 600.0)
    assert nothing.rows.shape == (1, 1)
    assert not nothing.is_filled.any()


def test_means_skip_absent_samples_and_impulses():
    """Powers and columns are averaged over the very same samples."""
    rng = np.random.default_rng(SEED)
    power = 0.1 * rng.normal(size=(100, 2))
    power[3, 0], power[4, 0], power[10:20, 1] = 9.0, np.nan, np.nan
    columns = np.repeat(np.arange(100.0)[:, None, None], 2, axis=1)
    stretches = still_stretches(np.arange(100) * 60.0, np.zeros((100, 3)), 600.0)
    means = stretch_means(stretches, power, columns)
    kept = [0, 1, 2, 5, 6, 7, 8, 9]
    assert means.power_db[0, 0] == pytest.approx(power[kept, 0].mean(), abs=1e-12)  # rounding
    assert means.columns[0, 0, 0] == pytest.approx(np.mean(kept), abs=1e-12)  # rounding
    assert means.rows_used[:, 1].tolist() == [10, 0]
    assert means.power_db[1, 1] == 0.0
    assert not means.is_kept[[3, 4], 0].any()
    # 90 samples: 1.5 sigma of a MAD is 0.1 * 1.17 * 1.5 / sqrt(90), three times that
    assert means.white_db == pytest.approx([0.1, 0.1], abs=0.04)


def test_a_sample_of_an_unknown_orbit_is_absent():
    """Columns with NaN take their sample out."""
    columns = np.ones((4, 1, 2))
    columns[1, 0, 1] = np.nan
    stretches = still_stretches(np.arange(4) * 60.0, np.zeros((4, 3)), 600.0)
    means = stretch_means(stretches, np.ones((4, 1)), columns)
    assert means.rows_used.tolist() == [[3]]
    assert means.white_db.tolist() == [0.0]
