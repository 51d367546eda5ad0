"""Peaks and searches."""

import numpy as np
import pytest

from analyzer_sim.instrument.functions.markers import Search, next_peak, peaks

#          0    1    2     3    4    5     6    7    8    9
LEVELS = np.array([-9.0, 0.0, -9.0, -2.0, -9.0, 3.0, -9.0, 1.0, -2.0, -1.0])


def test_peaks_stand_out_by_the_excursion_on_both_sides() -> None:
    assert peaks(LEVELS, 6.0) == [1, 3, 5]  # the last one has not fallen by 6 dB when the trace ends
    assert peaks(LEVELS, 2.5) == [1, 3, 5, 7]
    assert peaks(LEVELS, 8.0) == [1, 5]
    assert peaks(np.zeros(5), 6.0) == []
    assert peaks(np.array([5.0, 0.0, 0.0]), 3.0) == []  # the first point may be the flank of a peak outside


def test_ripple_smaller_than_the_excursion_is_one_peak() -> None:
    rng = np.random.default_rng(3)
    hill = -np.abs(np.arange(-200, 201)) / 5.0 + rng.uniform(-1.0, 1.0, 401)
    assert len(peaks(hill, 6.0)) == 1


@pytest.mark.parametrize(
    ("start", "search", "is_nearest", "found"),
    [
        (5, Search.NEXT, False, 1),
        (1, Search.NEXT, False, 3),
        (3, Search.NEXT, False, None),
        (5, Search.LEFT, True, 3),
        (5, Search.LEFT, False, 1),
        (1, Search.RIGHT, True, 3),
        (1, Search.RIGHT, False, 3),
        (3, Search.RIGHT, True, 5),
        (3, Search.RIGHT, False, None),
        (5, Search.RIGHT, True, None),
        (0, Search.LEFT, True, None),
    ],
)
def test_search_leads_to_the_next_peak(start: int, search: Search, is_nearest: bool, found: int | None) -> None:
    assert next_peak(LEVELS, 6.0, start, search, is_nearest=is_nearest) == found
