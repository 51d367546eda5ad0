"""Gaps by the usual distance of rows."""

import numpy as np
import pytest

from service.core.rows.row_gaps import STRETCH_ROWS, Gap, GapSearch

S = 1_000_000


def gaps_of(epochs_s: list[float], chunks: int = 1, start_s: int | None = None, stop_s: int | None = None) -> list[Gap]:
    """Return the gaps of rows that come in pieces, in seconds."""
    search = GapSearch(None if start_s is None else start_s * S)
    found: list[Gap] = []
    for chunk in np.array_split(np.array([round(each * S) for each in epochs_s]), chunks):
        found += search.add(chunk)
    found += search.end(None if stop_s is None else stop_s * S)
    return [Gap(gap.start_us // S, gap.stop_us // S, gap.rows_missing) for gap in found]


@pytest.mark.parametrize("chunks", [1, 2, 7])
def test_missing_rows_are_counted(chunks: int) -> None:
    rows = [10 * k for k in range(100) if k not in {3, 50, 51, 52}]
    assert gaps_of(rows, chunks) == [(30, 40, 1), (500, 530, 3)]


def test_jitter_is_no_gap() -> None:
    rng = np.random.default_rng(4)
    assert gaps_of([10 * k + rng.uniform(-2.0, 2.0) for k in range(2000)], 3) == []


def test_another_period_from_a_stretch_on_is_no_gap() -> None:
    fast = [float(k) for k in range(STRETCH_ROWS)]
    slow = [STRETCH_ROWS + 10.0 * k for k in range(STRETCH_ROWS)]
    assert gaps_of([*fast, *slow]) == []


def test_a_gap_between_stretches_counts_once() -> None:
    rows = [float(k) for k in range(STRETCH_ROWS)] + [STRETCH_ROWS + 4.0 + k for k in range(STRETCH_ROWS)]
    assert gaps_of(rows) == [(STRETCH_ROWS, STRETCH_ROWS + 4, 4)]


def test_edges_count_where_rows_are_expected() -> None:
    rows = [50.0, 60.0, 70.0]
    assert gaps_of(rows) == []
    assert gaps_of(rows, start_s=20, stop_s=100) == [(20, 50, 3), (80, 100, 2)]
    assert gaps_of(rows, start_s=50, stop_s=80) == []


def test_rows_of_one_epoch_count_as_one() -> None:
    assert gaps_of([0, 0, 10, 10, 20, 50]) == [(30, 50, 2)]


@pytest.mark.parametrize("rows", [[], [5.0], [5.0, 5.0]])
def test_without_a_distance_there_is_no_gap(rows: list[float]) -> None:
    assert gaps_of(rows, start_s=0, stop_s=100) == []
