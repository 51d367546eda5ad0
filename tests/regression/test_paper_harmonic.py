"""The published harmonic of Yamal-200 (Sevast'yanov 2013): am 0.3489, phi -0.6178, h -72.8866 dBW, period 23.98 h."""

import math

import numpy as np
import pytest

from service.core.estimation.paper.harmonic import fit_harmonic, fit_harmonics
from service.core.geometry.node_phase import node_phase_rad

AMPLITUDE_DB, PHI_RAD, OFFSET_DBM, RMS_DB = 0.3489, -0.6178, -72.8866 + 30.0, 0.1857
PERIOD_S = 23.98 * 3600.0
PERIOD_US = 86_328_000_000
NODE_US = 1_384_700_000_000_000  # a node in November 2013, the month of the paper
EPOCHS_US = NODE_US + 60_000_000 * np.arange(1440)
PHASE_RAD = node_phase_rad(EPOCHS_US, np.array([NODE_US]), PERIOD_S)


def power_dbm(phi_rad=PHI_RAD):
    return AMPLITUDE_DB * np.cos(PHASE_RAD + phi_rad) + OFFSET_DBM


def test_the_published_figures_come_back_to_nine_digits():
    fit = fit_harmonic(PHASE_RAD, power_dbm())
    assert fit.amplitude_db == pytest.approx(AMPLITUDE_DB, abs=1e-9)
    assert fit.phase_rad == pytest.approx(PHI_RAD, abs=1e-9)
    assert fit.offset_dbm == pytest.approx(OFFSET_DBM, abs=1e-9)
    assert fit.rms_db < 1e-9
    assert (fit.samples_used, fit.samples_rejected, fit.converged) == (1440, 0, True)


@pytest.mark.parametrize("phi_rad", [-0.6178, 0.6178, math.pi - 0.6178, 0.6178 - math.pi])
def test_all_four_quadrants_of_phi(phi_rad):
    assert fit_harmonic(PHASE_RAD, power_dbm(phi_rad)).phase_rad == pytest.approx(phi_rad, abs=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_the_published_noise_leaves_the_figures_within_three_sigmas(seed):
    print("seed", seed)
    noise_db = RMS_DB * np.random.default_rng(seed).standard_normal(1440)
    fit = fit_harmonic(PHASE_RAD, power_dbm() + noise_db)
    # 3 sigma: 0.1857 sqrt(2 / 1440), that over 0.3489, 0.1857 / sqrt(1440), 0.1857 / sqrt(2880)
    assert fit.amplitude_db == pytest.approx(AMPLITUDE_DB, abs=0.021)
    assert fit.phase_rad == pytest.approx(PHI_RAD, abs=0.06)
    assert fit.offset_dbm == pytest.approx(OFFSET_DBM, abs=0.015)
    assert fit.rms_db == pytest.approx(RMS_DB, abs=0.011)
    assert fit.converged


def test_the_claimed_errors_are_honest():
    noise_db = RMS_DB * np.random.default_rng(99).standard_normal((1440, 400))
    fits = fit_harmonics(PHASE_RAD, power_dbm()[:, None] + noise_db)
    spread_db = np.std(fits.offset_dbm)
    claimed_db = np.sqrt(fits.covariance[:, 0, 0].mean())
    # a standard deviation of 400 draws is good to 3.5 per cent; the gate takes 1.3 per cent off the claim; four sigmas
    assert claimed_db == pytest.approx(spread_db, rel=0.15)


@pytest.mark.parametrize("periods", [-30, 1, 365])
def test_whole_nodal_periods_change_nothing(periods):
    fit = fit_harmonic(PHASE_RAD, power_dbm())
    moved_rad = node_phase_rad(EPOCHS_US + periods * PERIOD_US, np.array([NODE_US]), PERIOD_S)
    moved = fit_harmonic(moved_rad, power_dbm())
    assert moved.amplitude_db == pytest.approx(fit.amplitude_db, abs=1e-9)
    assert moved.phase_rad == pytest.approx(fit.phase_rad, abs=1e-9)
    assert moved.offset_dbm == pytest.approx(fit.offset_dbm, abs=1e-9)
