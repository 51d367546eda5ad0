"""Levels and powers."""

import numpy as np
import pytest

from service.core.radio.decibel import DB_PER_NEPER, dbm_from_mw, mw_from_dbm


def test_nothing_has_no_level() -> None:
    assert np.isnan(dbm_from_mw([0.0, -1.0, np.nan])).all()


def test_decibels_of_samples_average_low() -> None:
    rng = np.random.default_rng(1)
    levels = dbm_from_mw(rng.exponential(1.0, 200_000))
    # -2.51 dB and 5.57 dB are the textbook figures; 3 standard errors are 0.04 dB
    assert float(levels.mean()) == pytest.approx(-2.51, abs=0.04)
    assert float(levels.std()) == pytest.approx(5.57, abs=0.04)


def test_small_deviations_are_nepers() -> None:
    assert float(mw_from_dbm(DB_PER_NEPER * 1e-6)) - 1.0 == pytest.approx(1e-6, rel=1e-5)  # first order only
