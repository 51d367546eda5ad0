"""Claims about the paper's rejection rule: what it rejects, what it cannot, and how it ends."""

import numpy as np
import pytest

from service.core.estimation.paper import sigma_clip
from service.core.estimation.paper.sigma_clip import fit_clipped


def constant(samples, **settings):
    return fit_clipped(np.ones((len(samples), 1)), np.asarray(samples, dtype=float)[:, np.newaxis], **settings)


def test_an_outlier_among_many_goes_and_the_rest_stays():
    samples = np.concatenate([np.linspace(-0.1, 0.1, 40), [100.0]])
    fit = constant(samples)
    assert fit.is_used[:, 0].tolist() == [True] * 40 + [False]
    assert fit.is_converged[0]
    assert fit.coefficients[0, 0] == pytest.approx(0.0, abs=1e-12)  # the 40 are symmetric


@pytest.mark.parametrize(("count", "is_kept"), [(8, True), (10, True), (11, False)])
def test_ten_samples_cannot_lose_an_outlier_of_100_db(count, is_kept):
    # the largest |r| / sigma of N samples about their mean is sqrt(N - 1), which exceeds 3 from N = 11 on
    samples = np.zeros(count)
    samples[0] = 100.0
    samples[1:] += np.linspace(-0.01, 0.01, count - 1)
    assert constant(samples).is_used[0, 0] == is_kept


def test_a_sample_rejected_on_the_first_pass_may_come_back():
    samples = np.array([0.38, 1.28, 1.84, 0.97, 0.19, 1.02, 0.97, 1.05, -0.74, -4.76, 1.11, -4.21])
    basis = np.stack([np.ones(12), np.arange(12) / 12], axis=1)
    first, final = (
        fit_clipped(basis, samples[:, np.newaxis], gate_sigma=1.5, max_iterations=limit, min_samples=1)
        for limit in (1, 50)
    )
    assert np.any(final.is_used & ~first.is_used)
    assert final.is_converged[0]


def test_the_final_set_confirms_itself():
    rng = np.random.default_rng(11)
    phase = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    basis = np.stack([np.ones(400), np.cos(phase), np.sin(phase)], axis=1)
    samples = 0.05 * rng.standard_normal(400)
    samples[:30] -= 3.0
    fit = fit_clipped(basis, samples[:, np.newaxis])
    assert fit.is_used[:30, 0].sum() == 0
    assert fit.is_used[30:, 0].sum() >= 365  # 3 sigma of a normal distribution refuses 0.3 per cent of 370
    residual = samples - basis @ fit.coefficients[0]
    assert np.array_equal(np.abs(residual) < 3.0 * fit.rms_db[0], fit.is_used[:, 0])
    assert fit.rms_db[0] == pytest.approx(np.sqrt(np.mean(residual[fit.is_used[:, 0]] ** 2)), rel=1e-12)  # rounding


def test_noise_free_data_lose_nothing_to_rounding():
    phase = np.linspace(0.0, 6.0, 200)
    basis = np.stack([np.ones(200), np.cos(phase)], axis=1)
    fit = fit_clipped(basis, (basis @ [-42.0, 0.3])[:, np.newaxis])
    assert fit.is_used.all()
    np.testing.assert_allclose(fit.coefficients, [[-42.0, 0.3]], rtol=0.0, atol=1e-13)  # rounding at a level of 42


def test_the_inverse_normal_matrix_is_that_of_the_samples_used():
    basis = np.stack([np.ones(30), np.linspace(-1.0, 3.0, 30)], axis=1)
    samples = basis @ [1.0, 2.0]
    samples[4] = np.nan
    fit = fit_clipped(basis, samples[:, np.newaxis])
    used = np.delete(basis, 4, axis=0)
    expected = np.linalg.inv(used.T @ used)
    np.testing.assert_allclose(fit.normal_inverse[0], expected, rtol=1e-12, atol=0.0)  # rounding, condition about 5


def test_rows_without_a_basis_are_absent():
    basis = np.ones((20, 1))
    basis[3] = np.nan
    assert not fit_clipped(basis, np.zeros((20, 2))).is_used[3].any()


@pytest.mark.parametrize(
    ("basis", "samples"),
    [
        (np.ones((7, 1)), np.zeros((7, 1))),  # too few samples
        (np.ones((20, 2)), np.zeros((20, 1))),  # two equal columns
        (np.zeros((20, 1)), np.zeros((20, 1))),  # a column of zeros
        (np.ones((20, 1)), np.full((20, 1), np.nan)),  # nothing present
    ],
)
def test_what_cannot_be_fitted_is_nan_and_uses_nothing(basis, samples):
    fit = fit_clipped(basis, samples)
    assert np.isnan(fit.coefficients).all()
    assert np.isnan(fit.normal_inverse).all()
    assert np.isnan(fit.rms_db).all()
    assert not fit.is_used.any()
    assert not fit.is_converged.any()


def test_carriers_do_not_influence_one_another():
    rng = np.random.default_rng(5)
    samples = rng.standard_t(2, (60, 6))
    basis = np.stack([np.ones(60), np.arange(60) / 60], axis=1)
    together = fit_clipped(basis, samples)
    for carrier in range(6):
        alone = fit_clipped(basis, samples[:, carrier : carrier + 1])
        assert np.array_equal(alone.is_used[:, 0], together.is_used[:, carrier])
        # sums of a batch are ordered differently
        np.testing.assert_allclose(alone.coefficients[0], together.coefficients[carrier], rtol=0.0, atol=1e-12)


def test_the_limit_of_passes_is_reported():
    samples = np.concatenate([np.zeros(60), np.ones(60), [9.0, 1000.0]])
    assert not constant(samples, max_iterations=1).is_converged[0]
    assert constant(samples).is_converged[0]


def test_a_cycle_ends_at_its_smallest_set(monkeypatch):
    # two million random cases found no cycle by itself; this one is forced: sets A, B, C, B, C, ...
    full = np.ones(12, dtype=bool)
    wide, narrow = full.copy(), full.copy()
    wide[:1], narrow[:3] = False, False
    following = {full.tobytes(): wide, wide.tobytes(): narrow, narrow.tobytes(): wide}
    monkeypatch.setattr(
        sigma_clip, "_retest", lambda _basis, _samples, _present, used, _gate: following[used[0].tobytes()][np.newaxis]
    )
    fit = constant(np.arange(12.0))
    assert np.array_equal(fit.is_used[:, 0], narrow)
    assert not fit.is_converged[0]
    assert fit.coefficients[0, 0] == pytest.approx(np.mean(np.arange(3, 12)), abs=1e-12)  # rounding
