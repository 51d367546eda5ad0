"""Noise of the carriers: Allan deviation, periodogram, quantisation, the model and its identification."""

import numpy as np
import pytest
from scipy.signal import lfilter

from service.core.estimation.noise import (
    allan_deviation_db,
    averaged_sigma_db,
    grouped_spectra,
    quantisation_step_db,
    regular_grid,
    split_noise,
)
from service.core.estimation.noise_identification import LADDER_S, UNSEEN_DB, identify_noise

EPOCHS_S = 60.0 * np.arange(4320)


def test_white_noise_falls_with_the_root_of_the_span():
    level = np.random.default_rng(1).normal(0.0, 0.2, (4320, 3))
    found = allan_deviation_db(level, EPOCHS_S, np.array([60.0, 240.0, 960.0]))
    # 270 means of 16 rows know their scatter to 4 %
    assert found == pytest.approx(0.2 / np.sqrt([[1.0], [4.0], [16.0]]) * np.ones((1, 3)), rel=0.15)


def test_a_drift_is_its_slope_times_the_span():
    found = allan_deviation_db((EPOCHS_S / 3600.0)[:, np.newaxis], EPOCHS_S, np.array([3600.0]))
    assert found[0, 0] == pytest.approx(1.0 / np.sqrt(2.0))


def test_gaps_are_no_noise():
    level = np.random.default_rng(2).normal(0.0, 0.2, (4320, 1))
    level[2000:] += 5.0
    whole = np.where((EPOCHS_S[:, np.newaxis] > 115_000.0) & (EPOCHS_S[:, np.newaxis] < 125_000.0), np.nan, level)
    # the step lies within the gap, and no pair of means reaches across it
    assert allan_deviation_db(whole, EPOCHS_S, np.array([3600.0]))[0, 0] < 0.06
    assert allan_deviation_db(level, EPOCHS_S, np.array([3600.0]))[0, 0] > 0.3


def test_too_little_says_nothing():
    spans = np.array([30.0, 60.0, 86_400.0])
    found = allan_deviation_db(np.zeros((4320, 1)), EPOCHS_S, spans)[:, 0]
    assert np.isnan(found).tolist() == [True, False, True], "rows are a minute apart, three days have two pairs"
    assert np.isnan(allan_deviation_db(np.full((10, 1), np.nan), EPOCHS_S[:10], spans)).all()
    assert np.isnan(allan_deviation_db(np.zeros((0, 2)), np.zeros(0), spans)).all()


def test_a_finer_cadence_is_thinned():
    grid = regular_grid(np.arange(200_000.0))
    assert grid.length <= 60_001
    assert grid.step_s == pytest.approx(200_000 / 60_000, rel=0.01)


def test_once_and_twice_a_day_take_no_part():
    rows = 4320
    wave = np.cos(2.0 * np.pi * np.arange(rows) / 1440.0)[:, np.newaxis]
    spectra = grouped_spectra(
        wave + np.cos(2.0 * np.pi * np.arange(rows) / 720.0)[:, np.newaxis],
        regular_grid(np.arange(rows) * 60.0),
        np.array([1200.0]),
        100,
    )
    # two whole waves over a whole number of days are two frequencies
    assert spectra.power.max() < 1e-12
    assert spectra.weight.sum() == rows // 2 - 2


def level(seed, spread_db=0.2, rows=4000):
    rng = np.random.default_rng(seed)
    return -43.21 + 0.2 * np.sin(np.arange(rows) / 200.0) + spread_db * rng.normal(size=rows)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("step_db", [0.02, 0.1, 0.15, 0.3])
def test_a_grid_is_found_whatever_its_step(seed, step_db):
    found = quantisation_step_db((np.round(level(seed) / step_db) * step_db).astype(np.float32))
    assert found == pytest.approx(step_db, rel=0.03)  # resolution of the transform


@pytest.mark.parametrize("seed", range(4))
def test_noise_added_after_the_rounding_blurs_the_grid_but_does_not_hide_it(seed):
    rounded = np.round(level(seed) / 0.15) * 0.15
    noise = np.random.default_rng(seed + 50).normal(size=len(rounded))
    assert quantisation_step_db(rounded + 0.03 * noise) == pytest.approx(0.15, rel=0.03)
    assert quantisation_step_db(rounded + 0.15 * noise) == 0.0


@pytest.mark.parametrize("seed", range(20))
def test_smooth_readings_have_no_step(seed):
    assert quantisation_step_db(level(seed).astype(np.float32)) == 0.0


def test_outliers_do_not_make_a_grid():
    values = level(3)
    values[::10] -= 6.0
    assert quantisation_step_db(values) == 0.0


@pytest.mark.parametrize("values", [np.zeros(0), np.full(500, np.nan), np.full(500, -40.0), level(1, rows=100)])
def test_too_little_to_say(values):
    assert quantisation_step_db(values) == 0.0


def noise(seed, rows=4320, white=0.15, coloured=0.1, tau_s=1200.0, step_s=60.0):
    rng = np.random.default_rng(seed)
    keep = np.exp(-step_s / tau_s)
    slow = np.empty(rows)
    slow[0] = coloured * rng.normal()
    for k in range(1, rows):
        slow[k] = keep * slow[k - 1] + coloured * np.sqrt(1.0 - keep**2) * rng.normal()
    return slow + white * rng.normal(size=rows)


@pytest.mark.parametrize("seed", range(4))
def test_three_days_of_white_and_coloured_noise_are_told_apart(seed):
    split = split_noise(noise(seed), 60.0)
    # the docstring's own figures: 10 % on sigmas, times two for the worst of a few seeds; 1.5 on the time, squared
    assert split.sigma_white_db == pytest.approx(0.15, rel=0.1)
    assert split.sigma_coloured_db == pytest.approx(0.10, rel=0.2)
    assert 1200.0 / 2.25 < split.correlation_time_s < 1200.0 * 2.25


def test_the_parts_add_up_to_the_variance_also_with_rows_absent():
    residual = noise(7)
    residual[::5] = np.nan
    split = split_noise(residual, 60.0)
    variance = np.nanmean((residual - np.nanmean(residual)) ** 2)
    # by construction; rounding only
    assert split.sigma_white_db**2 + split.sigma_coloured_db**2 == pytest.approx(variance, rel=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_white_noise_is_mostly_called_white(seed):
    split = split_noise(noise(seed, coloured=0.0), 60.0)
    # lags correlate by chance with 1.5 %: what is taken for coloured stays below a tenth of the variance
    assert split.sigma_coloured_db**2 < 0.1 * 0.15**2
    assert split.sigma_white_db == pytest.approx(0.15, rel=0.06)


def test_rows_that_do_not_correlate_have_no_coloured_part():
    split = split_noise(noise(1, coloured=0.0), 60.0)
    assert (split.sigma_coloured_db, split.correlation_time_s) == (0.0, 0.0)


def test_a_wander_longer_than_the_lags_counts_as_long():
    # noise-free and slower than twenty rows can show: every lag correlates alike, or better with distance
    residual = np.repeat([0.1, -0.1], 200)
    alternating = residual + np.tile([0.05, -0.05, 0.0, 0.0], 100)
    split = split_noise(alternating, 60.0)
    assert split.sigma_coloured_db == pytest.approx(0.1, rel=0.1)
    assert split.correlation_time_s > 20 * 60.0


def test_a_correlation_that_does_not_decay_gets_the_longest_time():
    # of a wave of 23 rows the last lags correlate better than the first; the trough between is left out
    rows = np.arange(4000)
    split = split_noise(np.cos(2.0 * np.pi * rows / 23.0), 60.0)
    assert split.correlation_time_s == pytest.approx(20 * 60.0 * 10.0)


@pytest.mark.parametrize("present", [0, 1, 59])
def test_too_few_rows_are_no_figure(present):
    residual = np.full(200, np.nan)
    residual[:present] = 0.1
    split = split_noise(residual, 60.0)
    assert np.isnan(split.sigma_white_db)
    assert np.isnan(split.sigma_coloured_db)
    assert split.correlation_time_s == 0.0


def test_rows_so_sparse_that_some_lags_have_no_pair_are_split_all_the_same():
    residual = np.full(400, np.nan)
    residual[::2] = noise(5)[:200]
    split = split_noise(residual, 60.0)
    assert split.sigma_white_db**2 + split.sigma_coloured_db**2 == pytest.approx(np.nanvar(residual), rel=1e-12)


def sigma(white, coloured, tau_s, rows, span_s):
    return averaged_sigma_db(np.array([white]), np.array([coloured]), np.array([tau_s]), rows=rows, span_s=span_s)[0]


def test_a_mean_of_one_row_keeps_everything():
    # sqrt of the sum of squares, rounding only
    assert sigma(0.15, 0.1, 1200.0, 1, 0.0) == pytest.approx(np.hypot(0.15, 0.1), rel=1e-12)


def test_white_noise_falls_with_the_root_of_the_rows_and_rows_below_one_count_as_one():
    assert sigma(0.15, 0.0, 0.0, 15, 840.0) == pytest.approx(0.15 / np.sqrt(15), rel=1e-12)
    assert sigma(0.15, 0.0, 0.0, 0, 0.0) == pytest.approx(0.15, rel=1e-12)


@pytest.mark.parametrize("x", [1e-4, 1e-3, 0.5, 3.0, 40.0])
def test_the_coloured_part_keeps_the_variance_of_a_mean_over_time(x):
    # by brute force: mean of the autocorrelation exp(-|s - t|) over the square [0, x]^2, midpoints
    grid = (np.arange(1500) + 0.5) * x / 1500
    kept = np.exp(-np.abs(grid[:, None] - grid)).mean()
    # midpoint rule on a kink: x / 1500 / 3
    assert sigma(0.0, 1.0, 600.0, 1, 600.0 * x) ** 2 == pytest.approx(kept, rel=1e-3)


def test_the_simulated_mean_has_the_stated_sigma():
    means = np.array([noise(seed, rows=15).mean() for seed in range(600)])
    # 600 means: 2.9 %, four sigma
    assert means.std() == pytest.approx(sigma(0.15, 0.1, 1200.0, 15, 840.0), rel=0.12)


def test_coloured_parts_of_a_carrier_add_up():
    parts, times = np.array([[0.1, 0.2], [0.05, 0.0]]), np.array([[300.0, 7200.0], [1200.0, 0.0]])
    together = averaged_sigma_db(np.array([0.15, 0.15]), parts, times, rows=15, span_s=840.0)
    each = [sigma(0.0, one, tau_s, 15, 840.0) for one, tau_s in zip(parts[0], times[0], strict=True)]
    # sums of squares, rounding only; a part of size and time zero adds nothing
    assert together[0] == pytest.approx(np.sqrt(0.15**2 / 15 + each[0] ** 2 + each[1] ** 2), rel=1e-12)
    assert together[1] == pytest.approx(sigma(0.15, 0.05, 1200.0, 15, 840.0), rel=1e-12)


NONE = (0.0, 0.0, 0.0, 0.0)
SEEDS = range(10)


def residuals(seed, rows, carriers, white, parts, *, common=NONE, step_s=60.0):
    """Return residuals (T, N) of noise with level and daily change fitted away, as a calibration leaves them."""
    rng = np.random.default_rng(seed)
    total = white * rng.normal(size=(rows, carriers))
    for columns, sizes in ((carriers, parts), (1, common)):
        for sigma_db, tau_s in zip(sizes, LADDER_S, strict=True):
            keep = np.exp(-step_s / tau_s)
            shocks = np.sqrt(1.0 - keep**2) * rng.normal(size=(rows, columns))
            shocks[0] /= np.sqrt(1.0 - keep**2)
            total = total + sigma_db * lfilter([1.0], [1.0, -keep], shocks, axis=0)
    angle = 2.0 * np.pi * np.arange(rows) * step_s / 86_250.0
    daily = np.column_stack([np.ones(rows), np.cos(angle), np.sin(angle), np.cos(2.0 * angle)])
    return total - daily @ np.linalg.lstsq(daily, total, rcond=None)[0]


def update(seed, rows=4320, carriers=16, white=0.155, parts=NONE, step_s=60.0, **options):
    values = residuals(seed, rows, carriers, white, parts, step_s=step_s, **options)
    return identify_noise(values, np.arange(rows) * step_s)


def test_sizes_come_back_from_three_days():
    """The four parts together look like flicker noise."""
    parts = np.array([0.06, 0.07, 0.08, 0.12])
    found = [update(seed, white=0.08, parts=parts) for seed in SEEDS]
    mean = np.mean([noise.sigma_db.mean(axis=0) for noise in found], axis=0)
    each = np.mean([noise.sigma_db.std(axis=0) for noise in found], axis=0)
    # mean of 16 carriers and 10 seeds; of the slowest the daily change has taken a share away with it
    assert mean == pytest.approx(parts, rel=0.12)
    assert np.mean([noise.white_db.mean() for noise in found]) == pytest.approx(0.08, rel=0.01)
    assert (each / parts < [0.15, 0.2, 0.2, 0.25]).all()


@pytest.mark.parametrize("carriers", [4, 16])
def test_of_white_noise_no_part_comes_out(carriers):
    found = [update(seed, carriers=carriers) for seed in SEEDS]
    largest = np.max([noise.sigma_db.max(axis=0) for noise in found], axis=0)
    # over 15 min white noise leaves 0.04 dB: none of these shows
    assert (largest < [0.03, 0.025, 0.02, 0.015]).all()
    assert not np.any([noise.common_db for noise in found])
    assert np.mean([noise.white_db.mean() for noise in found]) == pytest.approx(0.155, rel=0.01)


def test_what_carriers_share_is_told_apart():
    own, common = np.array([0.0, 0.09, 0.0, 0.0]), np.array([0.0, 0.0, 0.06, 0.06])
    found = [update(seed, parts=own, common=common) for seed in SEEDS]
    together = np.sqrt(np.mean([np.square(noise.common_db).sum() for noise in found]))
    mean = np.mean([noise.sigma_db.mean(axis=0) for noise in found], axis=0)
    # one series of three days holds seven correlation times of the slowest part
    assert together == pytest.approx(np.sqrt((common**2).sum()), rel=0.25)
    assert mean[1] == pytest.approx(0.09, rel=0.12)
    assert (mean[2:] < 0.03).all()


def test_what_six_hours_cannot_see_is_believed_in():
    noise = update(1, rows=360)
    assert (noise.sigma_db[:, 2:] > 0.5 * UNSEEN_DB).all()
    assert (noise.sigma_db <= 1.2 * UNSEEN_DB).all()
    # three days exclude it
    assert (update(1).sigma_db[:, 2:] < 0.2 * UNSEEN_DB).all()


def test_a_carrier_seen_little_borrows_from_all():
    values = residuals(3, 4320, 8, 0.1, (0.0, 0.09, 0.0, 0.1))
    whole = identify_noise(values, np.arange(4320) * 60.0)
    values[50:, 0] = np.nan
    values[:, 1] = np.nan
    noise = identify_noise(values, np.arange(4320) * 60.0)
    assert np.isfinite(noise.white_db).all()
    assert noise.sigma_db[:2] == pytest.approx(np.tile(np.median(noise.sigma_db[2:], axis=0), (2, 1)), rel=0.4)
    assert noise.sigma_db[2:] == pytest.approx(whole.sigma_db[2:], abs=0.02)


def test_gaps_do_not_bias():
    """A storm of eight hours cut out, and every third row of an hour."""
    parts = (0.0, 0.09, 0.0, 0.1)
    differences = []
    for seed in range(4):
        values = residuals(seed, 4320, 16, 0.1, parts)
        whole = identify_noise(values, np.arange(4320) * 60.0)
        values[1000:1480] = np.nan
        values[2000:2060:3, ::2] = np.nan
        differences.append(
            identify_noise(values, np.arange(4320) * 60.0).sigma_db.mean(axis=0) - whole.sigma_db.mean(axis=0)
        )
    # a ninth of the rows is lost: estimates move by a third of their own errors
    assert np.abs(np.mean(differences, axis=0)).max() < 0.012


def test_rows_of_five_minutes_tell_what_they_can():
    noise = update(2, rows=864, parts=(0.0, 0.09, 0.0, 0.1), step_s=300.0)
    slow = np.sqrt(np.square(noise.sigma_db[:, 1:]).sum(axis=1))
    assert slow.mean() == pytest.approx(np.hypot(0.09, 0.1), rel=0.2)
    # a part of 300 s looks nearly white to such rows
    assert np.hypot(noise.white_db, noise.sigma_db[:, 0]).mean() == pytest.approx(0.155, rel=0.06)


def test_a_noisy_carrier_keeps_its_own_size():
    """Half a decibel of slow noise on one of eight."""
    values = residuals(5, 4320, 8, 0.1, (0.0, 0.05, 0.0, 0.0))
    values[:, 2] += residuals(6, 4320, 1, 0.0, (0.0, 0.0, 0.5, 0.0))[:, 0]
    noise = identify_noise(values, np.arange(4320) * 60.0)
    assert noise.sigma_db[2, 2] == pytest.approx(0.5, rel=0.25)
    assert (np.delete(noise.sigma_db, 2, axis=0)[:, 2:] < 0.05).all()


@pytest.mark.parametrize("rows", [0, 1, 2, 50])
def test_next_to_nothing_gives_figures_all_the_same(rows):
    for values in (np.zeros((rows, 3)), np.full((rows, 3), np.nan)):
        noise = identify_noise(values, np.arange(rows) * 60.0)
        assert np.isfinite(noise.sigma_db).all()
        assert (noise.white_db > 0.0).all()
        assert np.isfinite(noise.common_db).all()


def test_order_of_carriers_does_not_matter():
    values = residuals(8, 2000, 6, 0.1, (0.0, 0.09, 0.0, 0.05))
    order = np.array([3, 0, 5, 1, 4, 2])
    one, other = (identify_noise(v, np.arange(2000) * 60.0) for v in (values, values[:, order]))
    # sums in another order: rounding through 500 passes
    assert other.sigma_db == pytest.approx(one.sigma_db[order], abs=1e-9)
