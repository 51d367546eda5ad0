"""Details take the bytes of the figures that are stated, and none where none is."""

import numpy as np
import pytest

from db.encoding.measurement_details import details_of, prepare_details
from service.records.levels.measurement import DETAIL_NAMES, CarrierDetails

NAN = float("nan")


def details(*kinds: int, rows: int = 3, carriers: int = 5) -> CarrierDetails:
    """Return details that state some kinds of figures in every row but the second."""
    figures = np.full((len(DETAIL_NAMES), rows, carriers), NAN, dtype=np.float32)
    for kind in kinds:
        figures[kind] = kind + np.arange(rows * carriers, dtype=np.float32).reshape(rows, carriers) / 7
    figures[:, 1] = NAN
    return CarrierDetails(*figures)


@pytest.mark.parametrize("kinds", [(0,), (3,), (0, 2), (1, 3), (0, 1, 2, 3)])
def test_figures_come_back_and_only_what_is_stated_takes_bytes(kinds):
    sent = details(*kinds)
    prepared = prepare_details(sent)
    assert prepared.width == 1 + 4 * 5 * len(kinds)
    assert prepared.is_stated.tolist() == [True, False, True]
    for row in range(3):
        reported = details_of(prepared.figures[row * prepared.width : (row + 1) * prepared.width], 5)
        for name in DETAIL_NAMES:
            # float32 widened: no tolerance
            np.testing.assert_array_equal(getattr(reported, name), getattr(sent, name)[row].astype(np.float64))


def test_what_states_nothing_is_nothing():
    assert prepare_details(None) is None
    assert prepare_details(details()) is None
