"""Claims about the daily harmonic."""

import numpy as np
import pytest

from service.core.estimation.paper.harmonic import evaluate_harmonic, fit_harmonic, fit_harmonics

PHASE_RAD = np.linspace(0.0, 2.0 * np.pi, 288, endpoint=False)


@pytest.mark.parametrize("phi", [-3.1, -2.0, -0.6178, 0.0, 0.9, 2.4, 3.1])
def test_amplitude_and_phase_are_recovered_in_all_quadrants(phi):
    fit = fit_harmonic(PHASE_RAD, 0.35 * np.cos(PHASE_RAD + phi) - 42.9)
    # rounding of float64 at a level of 43 dBm
    assert fit.amplitude_db == pytest.approx(0.35, abs=1e-12)
    assert fit.phase_rad == pytest.approx(phi, abs=1e-12)
    assert fit.offset_dbm == pytest.approx(-42.9, abs=1e-12)
    assert fit.rms_db < 1e-12


def test_the_fit_evaluates_to_the_data_without_their_level():
    rng = np.random.default_rng(3)
    power_dbm = rng.normal(-50.0, 5.0, 4) + evaluate_harmonic(PHASE_RAD, [0.1, 0.2, 0.3, 0.4], [3.0, -1.0, 0.0, 1.5])
    fits = fit_harmonics(PHASE_RAD, power_dbm)
    model_dbm = fits.offset_dbm + evaluate_harmonic(PHASE_RAD, fits.amplitude_db, fits.phase_rad)
    np.testing.assert_allclose(model_dbm, power_dbm, rtol=0.0, atol=1e-12)  # rounding


def test_shapes_of_the_evaluation():
    assert evaluate_harmonic(0.3, np.ones(5), np.zeros(5)).shape == (5,)
    assert evaluate_harmonic(np.zeros(3), 1.0, 0.0).shape == (3,)
    assert evaluate_harmonic(np.zeros(3), np.ones(5), np.zeros(5)).shape == (3, 5)


def test_it_is_the_solution_of_the_papers_normal_equations():
    rng = np.random.default_rng(20)
    power_dbm = -40.0 + 0.3 * np.cos(PHASE_RAD + 1.0) + 0.18 * rng.uniform(-1.0, 1.0, 288)  # bounded: nothing rejected
    c, s = np.cos(PHASE_RAD), np.sin(PHASE_RAD)
    matrix = np.array(
        [
            [288.0, c.sum(), s.sum()],
            [c.sum(), (c * c).sum(), (c * s).sum()],
            [s.sum(), (c * s).sum(), (s * s).sum()],
        ]
    )
    h, a1, a2 = np.linalg.solve(matrix, [power_dbm.sum(), (power_dbm * c).sum(), (power_dbm * s).sum()])
    fit = fit_harmonic(PHASE_RAD, power_dbm)
    assert fit.samples_rejected == 0
    # rounding of sums of 288 values of 40
    assert fit.offset_dbm == pytest.approx(h, abs=1e-11)
    assert fit.amplitude_db == pytest.approx(np.hypot(a1, a2), abs=1e-11)
    assert fit.phase_rad == pytest.approx(np.arctan2(-a2, a1), abs=1e-10)


def test_impulses_are_rejected_and_counted():
    rng = np.random.default_rng(7)
    power_dbm = -42.0 + 0.3 * np.cos(PHASE_RAD) + 0.05 * rng.uniform(-1.0, 1.0, 288)
    power_dbm[[5, 100, 200]] -= 6.0
    power_dbm[[6, 101]] = np.nan
    fit = fit_harmonic(PHASE_RAD, power_dbm)
    assert (fit.samples_used, fit.samples_rejected, fit.converged) == (283, 3, True)
    assert fit.amplitude_db == pytest.approx(0.3, abs=0.01)  # 3 sigma of 0.029 sqrt(2 / 283)


def test_the_covariance_is_that_of_repeated_experiments():
    rng = np.random.default_rng(13)
    phase_rad = PHASE_RAD[:200]  # not a full turn: h, a1, a2 correlate
    noise_db = 0.1 * rng.standard_normal((200, 3000))
    fits = fit_harmonics(phase_rad, noise_db, gate_sigma=100.0)
    a1, a2 = fits.amplitude_db * np.cos(fits.phase_rad), -fits.amplitude_db * np.sin(fits.phase_rad)
    spread = np.cov(np.stack([fits.offset_dbm, a1, a2]))
    # a (co)variance from 3000 draws is good to 2.6 per cent of the product of both sigmas; 10 per cent is four sigmas
    sigmas = np.sqrt(np.diagonal(spread))
    error = (fits.covariance.mean(axis=0) - spread) / np.outer(sigmas, sigmas)
    np.testing.assert_allclose(error, 0.0, rtol=0.0, atol=0.1)


@pytest.mark.parametrize(
    ("phase_rad", "power_dbm"),
    [
        (PHASE_RAD[:7], np.full(7, -42.0)),  # seven samples
        (np.full(100, 1.0), np.full(100, -42.0)),  # one phase
        (np.tile([0.0, 2.0], 50), np.full(100, -42.0)),  # two phases
        (PHASE_RAD, np.full(288, np.nan)),  # nothing measured
        (np.full(288, np.nan), np.full(288, -42.0)),  # no phase known
    ],
)
def test_what_cannot_be_fitted_is_nan(phase_rad, power_dbm):
    fit = fit_harmonic(phase_rad, power_dbm)
    assert np.isnan([fit.amplitude_db, fit.phase_rad, fit.offset_dbm, fit.rms_db]).all()
    assert np.isnan(fit.covariance).all()
    assert (fit.samples_used, fit.samples_rejected, fit.converged) == (0, 0, False)


def test_eight_samples_are_enough():
    fit = fit_harmonic(PHASE_RAD[::36], 0.2 * np.cos(PHASE_RAD[::36]) - 30.0)
    assert fit.samples_used == 8
    assert fit.amplitude_db == pytest.approx(0.2, abs=1e-12)  # rounding


def test_a_block_of_rain_of_45_per_cent_masks_the_rule():
    # a documented weakness of the published rule, held here so that nobody takes it for robust
    power_dbm = np.where(np.arange(288) < 130, -45.0, -42.0)
    fit = fit_harmonic(PHASE_RAD, power_dbm + 0.01 * np.sin(7.0 * PHASE_RAD))
    assert fit.samples_rejected == 0
    assert (
        fit.amplitude_db > 0.5
    )  # 3 dB over 45 per cent of the turn: first harmonic of a pulse, 2 * 3 sin(0.45 pi) / pi


def test_many_carriers_equal_one_at_a_time():
    rng = np.random.default_rng(2)
    power_dbm = rng.standard_t(3, (288, 5)) - 40.0
    power_dbm[rng.random((288, 5)) < 0.1] = np.nan
    fits = fit_harmonics(PHASE_RAD, power_dbm)
    for carrier in range(5):
        fit = fit_harmonic(PHASE_RAD, power_dbm[:, carrier])
        assert fit.samples_used == fits.samples_used[carrier] == fits.is_used[:, carrier].sum()
        assert fit.amplitude_db == pytest.approx(fits.amplitude_db[carrier], abs=1e-11)  # order of sums
