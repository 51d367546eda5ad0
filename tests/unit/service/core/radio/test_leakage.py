"""What a neighbour leaks into a band."""

import numpy as np
import pytest

from service.core.radio.band_weights import CarrierBands
from service.core.radio.leakage import leakage, leaked_ratio


def two(distance_hz: float, symbol_rate_hz: float = 1e6) -> CarrierBands:
    """Return two equal carriers at a distance."""
    return CarrierBands(
        np.array([970e6, 970e6 + distance_hz]),
        np.full(2, 1.25 * symbol_rate_hz),
        np.full(2, symbol_rate_hz),
        np.zeros(2, dtype=np.bool_),
        (),
    )


def test_a_far_neighbour_leaks_nothing() -> None:
    share = leakage(two(1.5e6), np.full(2, 0.25), 30e3)
    # 250 kHz between the edges are eight RBW: the Gaussian skirt is below any float
    assert share[0, 1] == pytest.approx(0.0, abs=1e-12)
    # 1e-3: the raised-cosine shape touches the band's edges with no power left
    assert share[0, 0] == pytest.approx(1.0, abs=1e-3)


def test_touching_bands_share_their_edges_and_overlapping_ones_more() -> None:
    touching = leakage(two(1.25e6), np.full(2, 0.25), 30e3)[0, 1]
    overlapping = leakage(two(1.1e6), np.full(2, 0.25), 30e3)[0, 1]
    assert 0.0 < touching < 1e-4 < overlapping
    assert overlapping < 0.2  # a fifth: 150 of 1250 kHz overlap, at the weak edge of the shape


def test_power_is_conserved_over_contiguous_bands() -> None:
    bands = CarrierBands(
        970e6 + 1e6 * np.arange(-3, 4), np.full(7, 1e6), np.full(7, 1e6), np.zeros(7, dtype=np.bool_), ()
    )
    share = leakage(bands, np.full(7, 0.25), 100e3)
    # the middle carrier's power falls entirely into the seven bands that tile 7 MHz
    assert share[:, 3].sum() == pytest.approx(1.0, abs=1e-9)


def test_a_line_falls_into_its_band() -> None:
    bands = CarrierBands(np.array([970e6]), np.array([300e3]), np.array([30e3]), np.array([True]), ())
    # a band of ten RBW catches a Gaussian but for 1e-11
    assert leakage(bands, np.array([0.25]), 30e3)[0, 0] == pytest.approx(1.0, abs=1e-9)


def test_leak_over_own_power() -> None:
    share = np.array([[1.0, 0.01], [0.01, 1.0]])
    ratio = leaked_ratio(share, np.array([1.0, 4.0]))
    np.testing.assert_allclose(ratio, [0.04, 0.0025], rtol=1e-12)  # products of two numbers
    absent = leaked_ratio(share, np.array([1.0, np.nan]))
    assert absent[0] == pytest.approx(0.0, abs=1e-15)
    assert np.isnan(absent[1])
