"""In which form a row is stored is nobody's business: duplicates, conflicts and readers see the same float32."""

import numpy as np
import pytest

LEVEL = np.float32(-50.12)
#: alone each of these is stored in a form of its own: steps of a hundredth, of a power of two, float32
ROWS = np.array(
    [[-50.12, -50.5, -49.0], [LEVEL, LEVEL, np.nextafter(LEVEL, np.float32(0))], [-50.12, 3e-30, np.nan]],
    dtype=np.float32,
)
FLAGS = ((0, 0, 0), (0, 1 << 22, 16), None)


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 0, 1], [1, 2, 0]])
def test_rows_sent_apart_are_those_sent_together(setting, make, order):
    epochs_us = [100 * position for position in order]
    setting.append(epochs_us, ROWS[order], flags=[FLAGS[position] for position in order])
    alone = [
        setting.append([100 * position], ROWS[position : position + 1], flags=[FLAGS[position]])
        for position in range(3)
    ]
    assert [(receipt.accepted, receipt.duplicates) for receipt in alone] == [(0, 1)] * 3
    held = setting.rows()
    np.testing.assert_array_equal(np.array([row.power_dbm for row in held]), ROWS.astype(np.float64))
    assert [None if row.flags is None else tuple(row.flags.tolist()) for row in held] == list(FLAGS)
    blocks = list(setting.storage.archive.measurement_blocks(setting.id, make.ever))
    np.testing.assert_array_equal(np.vstack([block.power_dbm for block in blocks]).view("<u4"), ROWS.view("<u4"))


def test_another_last_bit_or_flag_is_a_conflict_and_the_other_sign_of_zero_is_not(setting):
    powers = np.array([[-50.12, 0.0, np.nan]], dtype=np.float32)
    setting.append([5], powers, flags=[(0, 0, 0)])
    others = [np.nextafter(powers, np.float32(0)), np.array([[-50.12, 0.0, 0.0]])]
    for other in others:
        assert setting.append([5], other, flags=[(0, 0, 0)]).refused[0].code == "measurement.conflict"
    for flags in ((0, 1, 0), None):
        assert setting.append([5], powers, flags=[flags]).refused[0].code == "measurement.conflict"
    assert setting.append([5], powers, flags=[(0, 0, 0)]).duplicates == 1
    assert setting.append([5], np.array([[-50.12, -0.0, np.nan]]), flags=[(0, 0, 0)]).duplicates == 1


def test_the_time_of_receipt_comes_back(setting):
    setting.append([5, 1_000_000_000_000_000], ROWS[:2])
    assert [row.received_at_us for row in setting.rows()] == [77, 77]
