"""Claims about levels of turns and one-sided curvature."""

import numpy as np
import pytest

from service.core.estimation.paper.turn_levels import TurnLevels, one_sided_curvature, reduce_to_levels

SIZES_DEG = (0.125, 0.25, 0.375, 0.5)


def levels_of(axis_answer, axis=1, sizes=SIZES_DEG, noise_db=0.0, seed=0):
    """Return levels of turns about each axis and rests, the carrier answering to one axis by a function."""
    stops = [sign * size * np.eye(3)[turned] for turned in range(3) for size in sizes for sign in (1.0, -1.0)]
    angle_deg = np.array([level for stop in stops for level in (stop, np.zeros(3))])
    deviation_db = axis_answer(angle_deg[:, axis])[:, np.newaxis]
    return TurnLevels(
        angle_deg, deviation_db + noise_db * np.random.default_rng(seed).standard_normal(deviation_db.shape)
    )


def test_levels_are_means_of_angles_and_medians_of_powers():
    angle_deg = np.array([[0.0, 0.0, 0.0]] * 3 + [[0.0, 0.3, 0.0], [0.0, 0.31, 0.0], [0.0, 0.32, 0.0]])
    deviation_db = np.array([[1.0], [1.2], [50.0], [2.0], [-70.0], [2.1]])
    levels = reduce_to_levels(angle_deg, deviation_db)
    np.testing.assert_allclose(levels.angle_deg, [[0.0, 0.0, 0.0], [0.0, 0.31, 0.0]], rtol=0.0, atol=1e-15)  # rounding
    assert levels.deviation_db.tolist() == [[1.2], [2.0]]


def test_slews_are_left_out():
    angle_deg = np.zeros((24, 3))
    angle_deg[10:14, 1] = [0.1, 0.2, 0.3, 0.4]
    angle_deg[14:, 1] = 0.5
    assert reduce_to_levels(angle_deg, np.zeros((24, 1))).angle_deg[:, 1].tolist() == [0.0, 0.5]


def test_rows_that_are_levels_already_pass_through():
    angle_deg = np.array([[0.0, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.5, 0.0]])
    levels = reduce_to_levels(angle_deg, np.array([[0.0], [1.0], [3.0]]))
    assert np.array_equal(levels.angle_deg, angle_deg)
    assert levels.deviation_db.tolist() == [[0.0], [1.0], [3.0]]


def test_absent_rows_count_and_half_of_them_blank_a_level():
    deviation_db = np.array([[1.0, np.nan], [np.nan, np.nan], [3.0, 5.0], [np.nan, np.nan]])
    levels = reduce_to_levels(np.zeros((4, 3)), deviation_db)
    assert levels.deviation_db[0, 0] == 2.0
    assert np.isnan(levels.deviation_db[0, 1])


def test_rows_without_angles_are_left_out():
    angle_deg = np.zeros((4, 3))
    angle_deg[1] = np.nan
    assert reduce_to_levels(angle_deg, np.array([[1.0], [99.0], [1.0], [1.0]])).deviation_db.tolist() == [[1.0]]


def test_nothing_gives_no_levels():
    levels = reduce_to_levels(np.full((3, 3), np.nan), np.zeros((3, 2)))
    assert levels.angle_deg.shape == (0, 3)
    assert levels.deviation_db.shape == (0, 2)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_curvature_of_each_side_is_found(axis):
    levels = levels_of(lambda x: np.where(x > 0.0, 1.1 * x - 1.3 * x**2, 1.4 * x + 0.7 * x**2) + 0.2, axis)
    curvature = one_sided_curvature(levels, 0, axis, 0.5)
    np.testing.assert_allclose(curvature.q_db_per_deg2, [-1.3, 0.7], rtol=0.0, atol=1e-10)  # rounding, condition 1e2
    assert np.all(curvature.sigma_db_per_deg2 < 1e-10)
    assert curvature.excursion_deg == 0.5


def test_its_error_is_the_scatter_of_the_levels():
    fits = [
        one_sided_curvature(levels_of(lambda x: 1.2 * x, noise_db=0.05, seed=seed), 0, 1, 0.5) for seed in range(300)
    ]
    spread = np.std([fit.q_db_per_deg2 for fit in fits], axis=0)
    claimed = np.sqrt(np.mean([fit.sigma_db_per_deg2**2 for fit in fits], axis=0))
    np.testing.assert_allclose(claimed, spread, rtol=0.17)  # 300 draws: 4.1 per cent; four of these


def test_levels_beyond_the_range_take_no_part():
    levels = levels_of(lambda x: 1.2 * x - 5.0 * np.maximum(np.abs(x) - 0.5, 0.0), sizes=(0.2, 0.35, 0.5, 0.9))
    curvature = one_sided_curvature(levels, 0, 1, 0.5)
    np.testing.assert_allclose(curvature.q_db_per_deg2, 0.0, rtol=0.0, atol=1e-10)  # rounding
    assert curvature.excursion_deg == 0.5


def test_one_level_on_a_side_measures_no_curvature():
    levels = levels_of(lambda x: 1.2 * x, sizes=(0.5,))
    jitter = 0.005 * np.random.default_rng(1).standard_normal(levels.angle_deg.shape)
    curvature = one_sided_curvature(TurnLevels(levels.angle_deg + jitter, levels.deviation_db), 0, 1, 0.5)
    assert np.isnan(curvature.q_db_per_deg2).all()


def test_a_side_never_turned_has_none_and_the_other_keeps_its_own():
    levels = levels_of(lambda x: 1.1 * x - 1.3 * x**2)
    half = levels.angle_deg[:, 1] >= 0.0
    curvature = one_sided_curvature(TurnLevels(levels.angle_deg[half], levels.deviation_db[half]), 0, 1, 0.5)
    assert curvature.q_db_per_deg2[0] == pytest.approx(-1.3, abs=1e-10)  # rounding
    assert np.isnan(curvature.q_db_per_deg2[1])
    assert curvature.excursion_deg == 0.0


@pytest.mark.parametrize("case", ["no axis", "absent", "not turned", "no level to spare"])
def test_what_is_not_determined_is_nan(case):
    levels = levels_of(lambda x: 1.1 * x)
    axis = -1 if case == "no axis" else 1
    if case == "absent":
        levels = TurnLevels(levels.angle_deg, np.full_like(levels.deviation_db, np.nan))
    if case == "not turned":
        levels = TurnLevels(levels.angle_deg * [1.0, 0.0, 1.0], levels.deviation_db)
    if case == "no level to spare":
        levels = TurnLevels(np.vstack([levels.angle_deg[:1], np.eye(3) * 0.3]), np.zeros((4, 1)))
    curvature = one_sided_curvature(levels, 0, axis, 0.5)
    assert np.isnan(curvature.q_db_per_deg2).all()
    assert np.isnan(curvature.sigma_db_per_deg2).all()
    assert np.isnan(curvature.excursion_deg)
