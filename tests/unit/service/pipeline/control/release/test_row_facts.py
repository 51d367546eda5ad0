"""Facts of a row: what the interlock reads from it, and the band of the innovations."""

import math

import pytest
from scipy.stats import chi2

from service.pipeline.control.release.row_facts import facts_of_row, is_in_band
from service.records.catalogue import Method
from service.records.levels.attitude import row_without_attitude


def test_a_row_without_attitude_says_so():
    row = row_without_attitude(5_000_000, 5_100_000, 1, Method.ROBUST, ("no_fix",))
    facts = facts_of_row(row, 60.0, is_innovation_in_band=True)
    assert (facts.epoch_us, facts.period_s, facts.redundancy) == (5_000_000, 60.0, -3)
    assert facts.inhibitions == ("no_fix", "invalid")


@pytest.mark.parametrize(("values", "within"), [(6, 0.1), (16, 0.03), (40, 0.01), (480, 0.01)])
def test_the_band_holds_the_central_99_percent(values, within):
    for probability in (0.005, 0.995):
        edge = float(chi2.ppf(probability, values))
        assert is_in_band(edge * (1.0 + within), values) is (probability < 0.5)
        assert is_in_band(edge * (1.0 - within), values) is (probability > 0.5)


@pytest.mark.parametrize(("square", "values"), [(math.nan, 16), (16.0, 0), (-1.0, 16), (math.inf, 16)])
def test_what_is_no_statistic_is_outside(square, values):
    assert not is_in_band(square, values)
