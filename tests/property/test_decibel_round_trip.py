"""Round trips of levels."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from service.core.radio.decibel import (
    db_from_ratio,
    dbm_from_mw,
    mw_from_dbm,
    ratio_from_db,
)

levels = st.floats(min_value=-250.0, max_value=50.0)


@given(levels)
def test_level_to_power_and_back(level_dbm: float) -> None:
    # 1e-12 dB relative to 250 dB: a few units in the last place of the logarithm
    assert abs(float(dbm_from_mw(mw_from_dbm(level_dbm))) - level_dbm) <= 1e-11


@given(st.lists(levels, min_size=1, max_size=8), levels)
def test_a_gain_is_a_sum_in_decibels(level_dbm: list[float], gain_db: float) -> None:
    together = dbm_from_mw(mw_from_dbm(level_dbm) * ratio_from_db(gain_db))
    np.testing.assert_allclose(together, np.array(level_dbm) + gain_db, atol=1e-10)  # rounding of two powers of ten


@given(st.floats(min_value=1e-20, max_value=1e20), st.floats(min_value=1e-20, max_value=1e20))
def test_order_is_kept(first: float, second: float) -> None:
    smaller, larger = sorted((first, second))
    assert float(db_from_ratio(smaller)) <= float(db_from_ratio(larger))
