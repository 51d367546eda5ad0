"""Accuracy over seeds: known errors give known figures, and silence has none."""

import numpy as np
import pytest

from service.study.estimation.accuracy import AXES, accuracy_statistics, measure_accuracy

TIME = np.linspace(0.0, 12.0 * np.pi, 2000)
TRUTH = np.column_stack([0.3 * np.sin(TIME), 0.2 * np.cos(TIME), 0.1 * np.sin(2.0 * TIME)])
SIGMA = np.full_like(TRUTH, 0.02)


def figures(estimate, truth=TRUTH, sigma=SIGMA):
    return accuracy_statistics([measure_accuracy(estimate, sigma, truth)])


def test_the_truth_itself_is_perfect():
    found = figures(TRUTH)
    for axis in AXES:
        assert found[f"rms_deg.{axis}"] == found[f"p95_deg.{axis}"] == found[f"max_deg.{axis}"] == 0.0
        assert found[f"skill.{axis}"] == 1.0
        assert found[f"slope.{axis}"] == pytest.approx(1.0, rel=1e-12)  # rounding of two sums
        assert found[f"rms_over_sigma.{axis}"] == 0.0
    assert found["answered"] == 1.0


def test_the_answer_that_never_moves_has_no_skill_and_the_error_of_the_truth():
    found = figures(np.zeros_like(TRUTH))
    for axis in AXES:
        assert found[f"skill.{axis}"] == 0.0
        assert found[f"rms_deg.{axis}"] == found[f"truth_rms_deg.{axis}"]
        assert found[f"slope.{axis}"] == 0.0


def test_a_scaled_answer_has_its_slope_and_a_sigma_that_fits_is_honest():
    found = figures(0.5 * TRUTH, sigma=np.abs(0.5 * TRUTH))
    for axis in AXES:
        assert found[f"slope.{axis}"] == pytest.approx(0.5, rel=1e-9)
        # mean of the squared errors is exactly that of the squared sigmas
        assert found[f"rms_over_sigma.{axis}"] == pytest.approx(1.0, rel=1e-12)
        assert found[f"skill.{axis}"] == pytest.approx(0.75, rel=1e-12)


def test_rms_is_the_mean_of_seeds_and_skill_is_pooled():
    small, large = measure_accuracy(0.9 * TRUTH, SIGMA, TRUTH), measure_accuracy(np.zeros((9, 3)), SIGMA[:9], TRUTH[:9])
    found = accuracy_statistics([small, large])
    own = [np.sqrt(seed.mean_square_error[1]) for seed in (small, large)]
    assert found["rms_deg.roll"] == pytest.approx(np.mean(own), rel=1e-12)
    error = small.mean_square_error[1] + large.mean_square_error[1]
    truth = small.mean_square_truth[1] + large.mean_square_truth[1]
    assert found["skill.roll"] == pytest.approx(1.0 - error / truth, rel=1e-12)


def test_rows_without_an_answer_do_not_count_while_they_are_few():
    estimate = TRUTH.copy()
    estimate[::20] = np.nan
    found = figures(estimate)
    assert found["answered"] == pytest.approx(0.95)
    assert found["rms_deg.yaw"] == 0.0


@pytest.mark.parametrize("share", [0.0, 0.5, 0.89])
def test_silence_has_no_accuracy(share):
    estimate = TRUTH.copy()
    estimate[int(share * len(TRUTH)) :] = np.nan
    found = figures(estimate)
    assert found["answered"] == pytest.approx(share, abs=1e-3)
    assert all(np.isnan(found[f"{name}.{axis}"]) for name in ("rms_deg", "skill", "slope") for axis in AXES)


def test_one_silent_seed_takes_the_figures_of_all():
    good = measure_accuracy(TRUTH, SIGMA, TRUTH)
    silent = measure_accuracy(np.full_like(TRUTH, np.nan), SIGMA, TRUTH)
    assert np.isnan(accuracy_statistics([good, silent])["rms_deg.roll"])


def test_no_rows_at_all_are_no_answer():
    assert measure_accuracy(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3))).answered == 0.0
