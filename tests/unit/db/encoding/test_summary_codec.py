"""Summaries of a day as bytes: what they say of rows, and of damage."""

import numpy as np
import pytest

from db.encoding.summary_codec import pack_day, unpack_level, unpack_rows
from service.core.rows.summaries import Summaries

S = 1_000_000
RNG = np.random.default_rng(7)


@pytest.mark.parametrize(("step_us", "buckets"), [(60 * S, 24), (20 * S, 24), (19 * S, 24)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_levels_and_rows_come_back(step_us, buckets, dtype):
    epochs_us = 5 * 86_400 * S + np.arange(0, 86_400 * S, step_us)
    values = RNG.normal(size=(len(epochs_us), 3)).astype(dtype)
    values[RNG.random(values.shape) < 0.1] = np.nan
    made = pack_day(epochs_us, values, 2)
    hours = unpack_level(made.hours)
    rows = Summaries.of_rows(epochs_us, values)
    for found, wanted in zip(hours.buckets, rows.gathered(epochs_us // (3600 * S)), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-12)
    assert len(hours.starts) == buckets
    assert unpack_level(made.day).buckets.counts.tolist() == [np.isfinite(values).sum(axis=0).tolist()]
    level, frames = hours, made.row_frames
    if step_us < 20 * S:
        level = unpack_level(made.minute_frames[hours.starts[3] : hours.starts[3] + hours.sizes[3]])
        assert len(level.starts) == 60
    else:
        assert made.minute_frames is None
    opened = unpack_rows(frames[level.starts[3] : level.starts[3] + level.sizes[3]])
    first = np.searchsorted(epochs_us, opened.epochs_us[0])
    assert level.buckets.first_us[3] == opened.epochs_us[0]
    assert opened.values.dtype == dtype
    np.testing.assert_array_equal(opened.epochs_us, epochs_us[first : first + len(opened.epochs_us)])
    np.testing.assert_array_equal(opened.values, values[first : first + len(opened.epochs_us), :2])


def test_a_bit_flipped_anywhere_is_found():
    epochs_us = np.arange(0, 3600 * S, 300 * S)
    made = pack_day(epochs_us, RNG.normal(size=(len(epochs_us), 1)), 1)
    for blob, unpack in ((made.hours, unpack_level), (made.row_frames, unpack_rows)):
        # the first bytes name the format and the sizes; damage there is found by the reader of zstd too
        for position in range(len(blob)):
            spoilt = bytearray(blob)
            spoilt[position] ^= 1 << int(RNG.integers(8))
            try:
                found = unpack(bytes(spoilt))
            except ValueError:
                continue
            for one, other in zip(flat(found), flat(unpack(blob)), strict=True):
                np.testing.assert_array_equal(one, other)


def flat(found):
    """Return the arrays of what was unpacked."""
    return [*found[0], *found[1:]] if isinstance(found[0], Summaries) else list(found)
