"""phi1 and phi2 against fifty digits, on both sides of every seam."""

from decimal import Decimal, getcontext

import numpy as np
import pytest

from service.core.flexible.phi_functions import SERIES_BELOW, SHORT_SERIES_BELOW, phi1, phi2, phi2_scalar

getcontext().prec = 50
SEAMS = [one * (1.0 + nudge) for one in (SHORT_SERIES_BELOW, SERIES_BELOW) for nudge in (-1e-12, 0.0, 1e-12)]
PLACES = [1e-300, 1e-12, 1e-5, 3e-3, *SEAMS, 0.3, 1.0, 30.0, 700.0, -1e-4, -0.2, -0.6, -5.0]


def exact_phi2(z: float) -> float:
    wide = Decimal(z)
    # the difference loses as many digits as z has zeros: below 1e-20 the limit is exact to all digits of a float
    return 0.5 if abs(z) < 1e-20 else float((wide - 1 + (-wide).exp()) / wide**2)


@pytest.mark.parametrize("z", PLACES)
def test_phi2_has_all_digits(z: float) -> None:
    assert phi2_scalar(z) == pytest.approx(exact_phi2(z), rel=6e-16)
    assert phi2(np.array([z]))[0] == pytest.approx(exact_phi2(z), rel=6e-16)
    assert phi1(np.array([z]))[0] == pytest.approx(1.0 - z * exact_phi2(z), rel=1e-14)


def test_an_array_across_the_seam_is_evaluated_place_by_place() -> None:
    z = np.array(PLACES)
    np.testing.assert_allclose(phi2(z), [phi2_scalar(one) for one in PLACES], rtol=4e-16)


def test_at_zero_and_for_nothing() -> None:
    assert phi2_scalar(0.0) == 0.5
    assert phi2(np.zeros(2)).tolist() == [0.5, 0.5]
    assert phi2(np.array([])).tolist() == []
