"""Screening of a batch: each row for itself, first fault first."""

import numpy as np
import pytest

from service.pipeline.ingest_screening import HORIZON_US, EpochBounds, ReceivedRows, data_bounds, screen, system_bounds
from service.records.epoch import EARLIEST_EPOCH_US, LATEST_EPOCH_US

NOW_US = 1_800_000_000_000_000
BOUNDS = EpochBounds(EARLIEST_EPOCH_US, NOW_US + 5_000_000, NOW_US - 300_000_000)


def rows(powers, epochs_us=None, flags=None, first_seq=10):
    epochs_us = [NOW_US] * len(powers) if epochs_us is None else epochs_us
    flags = [None] * len(powers) if flags is None else flags
    return ReceivedRows("y", "s", 3, NOW_US, first_seq, np.array(epochs_us, dtype=np.int64), powers, flags)


def test_good_rows_pass_unchanged_and_absent_powers_become_nan():
    batch, refused = screen(rows([[-42.1, None], [None, None]], flags=[[0, 16], None]), 2, BOUNDS)
    assert refused == ()
    assert batch.index.tolist() == [0, 1]
    assert batch.power_dbm.dtype == np.float32
    # stored values are the nearest float32, exactly
    np.testing.assert_array_equal(batch.power_dbm, np.float32([[-42.1, np.nan], [np.nan, np.nan]]))
    assert batch.flags == ((0, 16), None)
    assert (batch.spacecraft_id, batch.source, batch.plan_id, batch.first_seq) == ("y", "s", 3, 10)


@pytest.mark.parametrize("power", [-250.0, 50.0, -249.999, 0.0, -0.0])
def test_ends_of_the_range_are_accepted(power):
    assert len(screen(rows([[power]]), 1, BOUNDS)[0].index) == 1


@pytest.mark.parametrize("power", [-250.0000001, 50.0000001, 1e300, -1e300])
def test_values_beyond_the_range_are_refused_even_where_float32_would_round_them_into_it(power):
    batch, refused = screen(rows([[None, -1.0], [0.0, power]]), 2, BOUNDS)
    assert batch.index.tolist() == [0]
    assert [(r.index, r.seq, r.code) for r in refused] == [(1, 11, "value.out_of_range")]


def test_rows_of_another_length_are_refused_by_count():
    batch, refused = screen(rows([[], [1.0], [1.0, 2.0], [1.0, 2.0, 3.0]], flags=[None, None, [0], [0, 0]]), 2, BOUNDS)
    assert len(batch.index) == 0
    assert batch.power_dbm.shape == (0, 2)
    assert {r.code for r in refused} == {"value.count"}
    assert [r.index for r in refused] == [0, 1, 2, 3]
    assert "2 carriers" in refused[0].detail


def test_bounds_of_time_are_inclusive_and_lateness_is_below_its_bound():
    epochs_us = [
        BOUNDS.earliest_us - 1,
        BOUNDS.earliest_us,
        BOUNDS.stale_before_us - 1,
        BOUNDS.stale_before_us,
        BOUNDS.latest_us,
        BOUNDS.latest_us + 1,
    ]
    batch, refused = screen(rows([[1.0]] * 6, epochs_us), 1, BOUNDS)
    assert [(r.index, r.code) for r in refused] == [(0, "time.too_old"), (5, "time.future")]
    assert batch.index.tolist() == [1, 2, 3, 4]
    assert batch.epochs_us.tolist() == epochs_us[1:5]
    assert batch.is_stale.tolist() == [True, True, False, False]


def test_the_first_fault_of_a_row_is_told_in_a_fixed_order():
    old_us, ahead_us = 0, BOUNDS.latest_us + 1
    batch, refused = screen(rows([[], [99.0], [99.0], [99.0]], [old_us, old_us, ahead_us, NOW_US]), 1, BOUNDS)
    assert len(batch.index) == 0
    assert [r.code for r in refused] == ["value.count", "time.too_old", "time.future", "value.out_of_range"]


def test_without_a_first_number_refusals_have_none():
    _, refused = screen(rows([[99.0]], first_seq=None), 1, BOUNDS)
    assert refused[0].seq is None


def test_an_empty_batch_is_a_batch():
    batch, refused = screen(rows([]), 3, BOUNDS)
    assert (len(batch.index), batch.power_dbm.shape, refused) == (0, (0, 3), ())


def test_the_system_clock_bounds_future_age_and_retention():
    assert system_bounds(NOW_US, 5.0, 300.0, None) == BOUNDS
    kept = system_bounds(NOW_US, 5.0, 300.0, 86_400.0)
    assert kept.earliest_us == NOW_US - 86_400_000_000
    assert system_bounds(EARLIEST_EPOCH_US, 5.0, 300.0, 1.0).earliest_us == EARLIEST_EPOCH_US


def test_the_data_clock_takes_a_first_row_of_this_century_and_never_makes_late():
    assert data_bounds(None, 10.0, 86_400.0) == EpochBounds(EARLIEST_EPOCH_US, LATEST_EPOCH_US, None)
    assert data_bounds(LATEST_EPOCH_US - 1, 10.0, None).latest_us == LATEST_EPOCH_US
    assert data_bounds(NOW_US, 10.0, None) == EpochBounds(EARLIEST_EPOCH_US, NOW_US + 10_000_000, None)
    epochs_us = [LATEST_EPOCH_US - HORIZON_US, LATEST_EPOCH_US, LATEST_EPOCH_US + 1]
    batch, refused = screen(rows([[1.0]] * 3, epochs_us), 1, data_bounds(None, 1.0, None))
    assert [(refusal.index, refusal.code) for refusal in refused] == [(2, "time.future")]
    assert "2100-01-01" in refused[0].detail
    assert batch.is_stale.tolist() == [False, False]
