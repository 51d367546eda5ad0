"""A figure is kept or missed as its tolerance says."""

import math

import pytest

from service.study.limit_cycles.comparison import Compared, holds


@pytest.mark.parametrize(
    ("reference", "found", "tolerance", "is_relative", "is_kept"),
    [
        (2.0, 2.0 + 1e-6, 1e-6, True, True),
        (2.0, 2.0 + 3e-6, 1e-6, True, False),
        (2.0, 2.0 + 3e-6, 1e-5, False, True),
        (-1.0, 1.0, 1e-5, True, False),
        (0.0, 0.0, 1e-6, True, True),
        (0.0, 1e-9, 1e-6, True, False),
        (math.inf, math.inf, 1e-6, True, True),
        (1.0, math.nan, 1e9, True, False),
        (1.0, math.inf, 1e-6, True, False),
    ],
)
def test_tolerance(reference, found, tolerance, is_relative, is_kept):
    assert Compared("case", "figure", reference, found, tolerance, is_relative).is_kept is is_kept


def test_ratio():
    assert Compared("case", "figure", 2.0, 3.0, 0.0).ratio == 1.5
    assert Compared("case", "figure", math.inf, math.inf, 0.0).ratio == 1.0
    assert math.isinf(Compared("case", "figure", 0.0, 1.0, 0.0).ratio)


def test_a_claim_is_a_figure():
    assert holds("case", "claim", is_true=True).is_kept
    assert not holds("case", "claim", is_true=False).is_kept
