"""Claims about observability figures."""

import math

import numpy as np
import pytest

from service.core.estimation.observability import (
    angle_dilution_deg_per_db,
    common_share,
    condition_number,
    crlb_deg,
    dilution_of_precision_deg_per_db,
    leverages,
    normal_inverse,
)

RNG = np.random.default_rng(19)
SENSITIVITY = RNG.normal(0.0, [0.16, 1.4, 1.2], (16, 3))
SIGMA_DB = RNG.uniform(0.1, 0.3, 16)


@pytest.mark.parametrize("with_common", [False, True])
def test_the_bound_is_the_textbook_formula(with_common):
    design = np.column_stack([SENSITIVITY, np.ones(16)]) if with_common else SENSITIVITY
    fisher = design.T @ np.diag(SIGMA_DB**-2) @ design
    expected = np.sqrt(np.diagonal(np.linalg.inv(fisher)))[:3]
    # normal equations at a condition of about 1e3
    np.testing.assert_allclose(crlb_deg(SENSITIVITY, SIGMA_DB, with_common), expected, rtol=1e-11, atol=0.0)


def test_an_unbiased_fix_reaches_the_bound():
    root = np.linalg.qr(SENSITIVITY / SIGMA_DB[:, None])
    noise = np.random.default_rng(3).standard_normal((20_000, 16))
    errors_deg = np.linalg.solve(root.R, root.Q.T @ noise.T)
    # a standard deviation of 20 000 draws is good to 0.5 per cent; four of these
    np.testing.assert_allclose(errors_deg.std(axis=1), crlb_deg(SENSITIVITY, SIGMA_DB, with_common=False), rtol=0.02)


def test_a_common_unknown_never_helps():
    assert np.all(
        crlb_deg(SENSITIVITY, SIGMA_DB, with_common=True) >= crlb_deg(SENSITIVITY, SIGMA_DB, with_common=False)
    )


def test_absent_carriers_do_not_count():
    sensitivity, sigma_db = SENSITIVITY.copy(), SIGMA_DB.copy()
    sensitivity[0, 1], sigma_db[1], sigma_db[2] = np.nan, np.nan, 0.0
    expected = crlb_deg(SENSITIVITY[3:], SIGMA_DB[3:], with_common=True)
    np.testing.assert_allclose(crlb_deg(sensitivity, sigma_db, with_common=True), expected, rtol=1e-13)  # rounding
    assert condition_number(sensitivity) == condition_number(SENSITIVITY[1:])


def test_dilution_is_the_bound_for_one_db():
    expected = crlb_deg(SENSITIVITY, np.full(16, 0.2), with_common=True) / 0.2
    actual = dilution_of_precision_deg_per_db(SENSITIVITY, with_common=True)
    np.testing.assert_allclose(actual, expected, rtol=1e-12)  # rounding
    ellipsoid = math.sqrt(np.linalg.det(np.linalg.inv(SENSITIVITY.T @ SENSITIVITY)))
    assert angle_dilution_deg_per_db(SENSITIVITY) == pytest.approx(ellipsoid ** (1.0 / 3.0), rel=1e-12)  # rounding


@pytest.mark.parametrize(
    "sensitivity",
    [
        np.ones((2, 3)),  # two carriers
        np.outer(np.arange(1.0, 9.0), [1.0, 2.0, 3.0]),  # one mixture of angles
        np.column_stack([np.zeros(8), RNG.standard_normal((8, 2))]),  # yaw moves nothing
        np.full((8, 3), np.nan),
    ],
)
def test_what_cannot_be_observed_is_nan_and_infinitely_conditioned(sensitivity):
    assert np.isnan(crlb_deg(sensitivity, np.ones(len(sensitivity)), with_common=False)).all()
    assert math.isnan(angle_dilution_deg_per_db(sensitivity))
    assert math.isnan(common_share(sensitivity))
    assert condition_number(sensitivity) > 1e15
    assert np.isnan(leverages(sensitivity)).all()


def test_a_matrix_of_zeros_has_no_condition():
    assert condition_number(np.zeros((5, 3))) == math.inf


def test_the_share_of_a_common_change_lies_between_none_and_all():
    balanced = np.vstack([np.eye(3), -np.eye(3)])
    assert common_share(balanced) == pytest.approx(0.0, abs=1e-15)  # rounding
    one_sided = np.column_stack([np.ones(6), RNG.standard_normal((6, 2))])
    assert common_share(one_sided) == pytest.approx(1.0, abs=1e-12)  # rounding


@pytest.mark.parametrize("with_common", [False, True])
def test_leverages_add_up_to_the_unknowns(with_common):
    assert leverages(SENSITIVITY, with_common=with_common).sum() == pytest.approx(
        3 + with_common, abs=1e-12
    )  # rounding


def test_a_carrier_that_alone_feels_an_axis_has_full_leverage():
    sensitivity = SENSITIVITY.copy()
    sensitivity[1:, 0] = 0.0
    assert leverages(sensitivity)[0] == pytest.approx(1.0, abs=1e-12)  # rounding


def test_an_absent_carrier_has_no_leverage():
    sensitivity = SENSITIVITY.copy()
    sensitivity[4] = np.nan
    assert np.flatnonzero(np.isnan(leverages(sensitivity))).tolist() == [4]


def test_the_inverse_is_good_for_columns_of_any_unit():
    design = SENSITIVITY * [1e-6, 1.0, 1e6]
    expected = np.linalg.inv(SENSITIVITY.T @ SENSITIVITY) / np.outer([1e-6, 1.0, 1e6], [1e-6, 1.0, 1e6])
    np.testing.assert_allclose(normal_inverse(design), expected, rtol=1e-11)  # normal equations at a condition of 1e3
