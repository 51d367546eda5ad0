"""Samples of long spans against the same figures computed row by row."""

import numpy as np
import pytest
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from service.core.rows.sample_bins import SampleBins


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 40), st.integers(1, 60), st.integers(1, 10**12))
def test_every_row_is_counted_once_in_its_interval(seed: int, count: int, rows: int, span_us: int) -> None:
    rng = np.random.default_rng(seed)
    start_us = 1_795_219_200_000_000
    epochs_us = np.sort(start_us + rng.integers(0, span_us, rows))
    values = rng.normal(0.0, 1.0, (rows, 2)).astype(np.float32)
    values[rng.random((rows, 2)) < 0.2] = np.nan
    bins = SampleBins(start_us, start_us + span_us, count, 2)
    cut = rng.integers(0, rows + 1)
    bins.add(epochs_us[:cut], values[:cut])
    bins.add(epochs_us[cut:], values[cut:])
    positions = np.array([(each - start_us) * count // span_us for each in epochs_us.tolist()])
    samples = bins.all_intervals()
    assert samples.first_us.tolist() == [start_us + -(-position * span_us // count) for position in range(count)]
    for column, position in np.ndindex(2, count):
        inside = (positions == position) & np.isfinite(values[:, column])
        level, cell = values[inside, column], (position, column)
        assert samples.counts[cell] == len(level)
        if len(level):
            # float64 sums of float32: the order of adding changes the last digits
            assert samples.sums[cell] == pytest.approx(level.astype(float).sum(), rel=1e-12, abs=1e-12)
            assert (samples.minima[cell], samples.maxima[cell]) == (level.min(), level.max())
            assert samples.minimum_us[cell] == epochs_us[inside][level.argmin()]
            assert samples.maximum_us[cell] == epochs_us[inside][level.argmax()]


def test_no_rows_no_samples() -> None:
    bins = SampleBins(0, 10, 5, 1)
    bins.add(np.empty(0, dtype=np.int64), np.empty((0, 1)))
    assert bins.all_intervals().counts.tolist() == [[0]] * 5
