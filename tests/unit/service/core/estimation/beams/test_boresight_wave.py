"""Daily and yearly change of a series: what is told, what is too short, and how sure it is."""

import math

import numpy as np
import pytest

from service.core.estimation.beams.boresight_wave import UNKNOWN_FIT, fit_boresight

DAY_S, YEAR_S = 86_400.0, 365.25 * 86_400.0
START_S = 20_800 * DAY_S + 7200.0


def hours(days, step_h=1):
    return START_S + 3600.0 * np.arange(0, int(24 * days), step_h)


def test_mean_drift_and_wave_come_back():
    at_s = hours(3)
    value = 0.01 + 0.002 * (at_s - at_s.mean()) / DAY_S + 0.03 * np.cos(2 * np.pi * (at_s - 5 * 3600.0) / DAY_S)
    fit = fit_boresight(at_s, value, np.full(len(at_s), 0.01))
    assert fit.mean_deg == pytest.approx(0.01)
    assert fit.drift_deg_per_day == pytest.approx(0.002)
    assert (fit.daily.amplitude_deg, fit.daily.peak_s) == pytest.approx((0.03, 5 * 3600.0))
    assert math.isnan(fit.yearly.amplitude_deg)
    assert fit.residual_rms_deg == pytest.approx(0.0, abs=1e-12)


def test_a_year_of_every_seventh_day_tells_both_waves():
    at_s = np.concatenate([hours(1) + 7 * k * DAY_S for k in range(53)])
    value = 0.02 * np.cos(2 * np.pi * (at_s % YEAR_S) / YEAR_S - 1.0) + 0.01 * np.sin(2 * np.pi * at_s / DAY_S)
    fit = fit_boresight(at_s, value, np.full(len(at_s), 0.01))
    assert fit.yearly.amplitude_deg == pytest.approx(0.02)
    assert fit.yearly.peak_s == pytest.approx(YEAR_S / (2 * np.pi))
    assert fit.daily.amplitude_deg == pytest.approx(0.01)


@pytest.mark.parametrize("common", [0.0, 0.7], ids=["white", "coloured"])
def test_sigma_of_the_wave_holds_also_for_noise_of_hours(common):
    seed = 3
    print("seed", seed, common)
    rng = np.random.default_rng(seed)
    at_s = hours(4)
    parts, stated = [], []
    for _ in range(200):
        noise = rng.normal(0.0, 0.01, len(at_s))
        for k in range(1, len(noise)):
            noise[k] = common * noise[k - 1] + math.sqrt(1.0 - common**2) * noise[k]
        daily = fit_boresight(at_s, noise, np.full(len(at_s), 0.01)).daily
        angle = 2 * np.pi * daily.peak_s / DAY_S
        parts.append(daily.amplitude_deg * np.array([np.cos(angle), np.sin(angle)]))
        stated.append(daily.sigma_deg)
    ratio = np.std(parts) / np.mean(stated)
    print("error over stated sigma", ratio)
    assert 0.7 < ratio < 1.35


@pytest.mark.parametrize(
    ("at_s", "why"),
    [(hours(1), "a day does not tell a wave from a drift"), (hours(3)[::8], "three hours of the day alone")],
)
def test_too_short_for_a_wave(at_s, why):
    fit = fit_boresight(at_s, np.full(len(at_s), 0.01), np.full(len(at_s), 0.01))
    assert fit.mean_deg == pytest.approx(0.01), why
    assert math.isnan(fit.daily.amplitude_deg), why


def test_too_short_for_anything():
    assert fit_boresight(hours(1)[:4], np.zeros(4), np.ones(4)) == UNKNOWN_FIT
    at_s = hours(2)
    assert fit_boresight(at_s, np.full(len(at_s), np.nan), np.ones(len(at_s))) == UNKNOWN_FIT
