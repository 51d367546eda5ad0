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
    for column in range(2):
        samples = bins.samples(column)
        reported = zip(samples.starts_us.tolist(), samples.counts.tolist(), strict=True)
        held = values[:, column]
        wanted = []
        for position in range(count):
            inside = (positions == position) & np.isfinite(held)
            if inside.any():
                begin = start_us + -(-position * span_us // count)
                wanted.append((begin, int(inside.sum())))
        assert list(reported) == wanted
        for k, begin_us in enumerate(samples.starts_us.tolist()):
            position = (begin_us - start_us) * count // span_us
            inside = (positions == position) & np.isfinite(held)
            # float64 sums of float32: the order of adding changes the last digits
            assert samples.means[k] == pytest.approx(held[inside].astype(float).mean(), rel=1e-12, abs=1e-12)
            assert samples.minima[k] == held[inside].min()
            assert samples.maxima[k] == held[inside].max()
            assert samples.minimum_epochs_us[k] == epochs_us[inside][held[inside].argmin()]
            assert samples.maximum_epochs_us[k] == epochs_us[inside][held[inside].argmax()]


def test_no_rows_no_samples() -> None:
    bins = SampleBins(0, 10, 5, 1)
    bins.add(np.empty(0, dtype=np.int64), np.empty((0, 1)))
    assert len(bins.samples(0).counts) == 0
