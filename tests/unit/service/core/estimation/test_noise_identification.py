"""Noise learned from residuals: sizes come back, what is not there stays away, what cannot be seen is not excluded."""

import numpy as np
import pytest
from scipy.signal import lfilter

from service.core.estimation.noise_identification import LADDER_S, UNSEEN_DB, identify_noise

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
    print(f"seeds 0..9: sizes {mean}, scatter of carriers {each}")
    # mean of 16 carriers and 10 seeds; of the slowest the daily change has taken a share away with it
    assert mean == pytest.approx(parts, rel=0.12)
    assert np.mean([noise.white_db.mean() for noise in found]) == pytest.approx(0.08, rel=0.01)
    assert (each / parts < [0.15, 0.2, 0.2, 0.25]).all()


@pytest.mark.parametrize("carriers", [4, 16])
def test_of_white_noise_no_part_comes_out(carriers):
    found = [update(seed, carriers=carriers) for seed in SEEDS]
    largest = np.max([noise.sigma_db.max(axis=0) for noise in found], axis=0)
    print(f"seeds 0..9, {carriers} carriers: largest parts {largest}")
    # over 15 min white noise leaves 0.04 dB: none of these shows
    assert (largest < [0.03, 0.025, 0.02, 0.015]).all()
    assert not np.any([noise.common_db for noise in found])
    assert np.mean([noise.white_db.mean() for noise in found]) == pytest.approx(0.155, rel=0.01)


def test_what_carriers_share_is_told_apart():
    own, common = np.array([0.0, 0.09, 0.0, 0.0]), np.array([0.0, 0.0, 0.06, 0.06])
    found = [update(seed, parts=own, common=common) for seed in SEEDS]
    together = np.sqrt(np.mean([np.square(noise.common_db).sum() for noise in found]))
    mean = np.mean([noise.sigma_db.mean(axis=0) for noise in found], axis=0)
    print(f"seeds 0..9: common {together:.3f} of {np.sqrt((common**2).sum()):.3f}, own {mean}")
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
