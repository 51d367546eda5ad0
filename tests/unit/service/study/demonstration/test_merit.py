"""Figures of merit: known errors give known figures, and the answer that never moves cannot pass."""

import math

import numpy as np
import pytest

from service.study.demonstration.merit import AXES, AxisMerit, judge_axis, missed_bounds

TRUTH = 0.3 * np.sin(np.linspace(0.0, 12.0 * np.pi, 2000))
GOOD = AxisMerit(0.03, 0.06, 0.2, 0.9, 1.0)


def merits(**changes):
    return {axis: changes.get(axis, GOOD) for axis in AXES}


def test_the_truth_itself_is_perfect():
    found = judge_axis(TRUTH, TRUTH)
    assert (found.rms_deg, found.error_95_deg, found.skill) == (0.0, 0.0, 1.0)
    assert found.slope == pytest.approx(1.0, rel=1e-12)
    assert found.truth_rms_deg == pytest.approx(0.3 / math.sqrt(2), rel=1e-3)  # whole waves, 2000 samples


def test_a_scaled_and_shifted_answer_has_its_slope_and_error():
    found = judge_axis(0.5 * TRUTH + 0.1, TRUTH)
    assert found.slope == pytest.approx(0.5, rel=1e-9)
    # independent parts: 0.1 of offset and half the truth; the mean of the sine over whole waves is zero
    assert found.rms_deg == pytest.approx(math.hypot(0.1, 0.5 * found.truth_rms_deg), rel=1e-3)
    assert found.skill == pytest.approx(1.0 - (found.rms_deg / found.truth_rms_deg) ** 2, rel=1e-12)


def test_the_95_percent_error_is_a_quantile_of_the_size():
    error = np.concatenate([np.full(96, 0.01), np.full(4, -1.0)])
    truth = np.linspace(-0.2, 0.2, 100)
    assert judge_axis(truth + error, truth).error_95_deg == pytest.approx(0.01, abs=1e-12)


def test_rows_without_an_estimate_do_not_count():
    estimate = TRUTH.copy()
    estimate[::3] = np.nan
    assert judge_axis(estimate, TRUTH).rms_deg == 0.0


@pytest.mark.parametrize("present", [0, 1])
def test_nothing_to_judge_is_nan_and_misses_every_bound(present):
    estimate = np.full(10, np.nan)
    estimate[:present] = 0.1
    nothing = judge_axis(estimate, np.linspace(0, 1, 10))
    assert np.isnan(nothing).all()
    assert len(missed_bounds(dict.fromkeys(AXES, nothing), "paper")) == 7


def test_the_answer_that_never_moves_misses_the_bounds():
    zero = judge_axis(np.zeros(len(TRUTH)), TRUTH)
    assert zero.skill == pytest.approx(0.0, abs=1e-12)
    missed = missed_bounds(dict.fromkeys(AXES, zero), "paper")
    assert [text.split(" ")[0:2] for text in missed] == [
        ["roll", "rms"],
        ["roll", "slope"],
        ["pitch", "rms"],
        ["pitch", "slope"],
    ]


def test_good_figures_miss_nothing_and_bounds_are_inclusive():
    assert missed_bounds(merits(), "paper") == []
    assert missed_bounds(merits(), "robust") == []
    assert missed_bounds(merits(roll=AxisMerit(0.08, 0.2, 0.12, 0.5, 1.0)), "paper") == []
    assert missed_bounds(merits(roll=AxisMerit(0.03, 0.2, 0.12, 0.5, 1.04)), "robust") == []


@pytest.mark.parametrize(
    ("method", "axis", "changes", "text"),
    [
        ("paper", "roll", {"rms_deg": 0.081}, "roll rms 0.081 deg above 0.08"),
        ("paper", "pitch", {"rms_deg": 0.101}, "pitch rms 0.101 deg above 0.1"),
        ("paper", "roll", {"slope": 1.16}, "roll slope 1.160 not within 1 +- 0.15"),
        ("paper", "pitch", {"slope": 0.84}, "pitch slope 0.840 not within 1 +- 0.15"),
        ("paper", "yaw", {"truth_rms_deg": 0.119}, "yaw truth rms 0.119 deg below 0.12: too little moved"),
        ("robust", "roll", {"rms_deg": 0.031}, "roll rms 0.031 deg above 0.03"),
        ("robust", "pitch", {"slope": 0.94}, "pitch slope 0.940 not within 1 +- 0.05"),
        ("robust", "yaw", {"rms_deg": 0.181}, "yaw rms 0.181 deg above 0.18"),
        ("robust", "yaw", {"slope": 0.69}, "yaw slope 0.690 not within 1 +- 0.3"),
    ],
)
def test_each_bound_is_named_when_it_is_missed(method, axis, changes, text):
    assert missed_bounds(merits(**{axis: GOOD._replace(**changes)}), method) == [text]


def test_yaw_of_the_paper_method_is_shown_and_not_bounded():
    assert missed_bounds(merits(yaw=GOOD._replace(rms_deg=9.0, slope=0.0)), "paper") == []


def test_a_craft_that_is_kept_still_is_judged_by_its_errors_alone():
    still = AxisMerit(0.02, 0.04, 0.02, 0.0, 0.1)
    far = AxisMerit(0.5, 0.9, 0.02, -600.0, 0.1)
    assert missed_bounds(merits(yaw=still, roll=still, pitch=still), "robust", is_moved=False) == []
    assert missed_bounds(merits(yaw=still, roll=far, pitch=still), "robust", is_moved=False) == [
        "roll rms 0.500 deg above 0.03"
    ]
    assert len(missed_bounds(merits(yaw=still, roll=still, pitch=still), "robust")) == 6
