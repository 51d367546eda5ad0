"""Every storage gives measurements as blocks: the same rows in the same order as one by one."""

import tracemalloc

import numpy as np
import pytest
from block_rows import row_sources

from service.errors import NotFoundError
from service.records.calibration import Window


def reported(setting, window, **options):
    """Return (source, plan, epoch, powers as bytes) of the rows of all blocks, in order."""
    found = []
    for block in setting.storage.archive.measurement_blocks(setting.id, window, **options):
        assert block.power_dbm.dtype == np.float32
        assert block.power_dbm.shape[0] == len(block.epochs_us) > 0
        rows = zip(row_sources(block), block.epochs_us.tolist(), block.power_dbm, strict=True)
        found += [(source, block.plan_id, epoch_us, powers.tobytes()) for source, epoch_us, powers in rows]
    return found


def expected(rows):
    return [(row.source, row.plan_id, row.epoch_us, row.power_dbm.astype(np.float32).tobytes()) for row in rows]


def test_blocks_hold_the_rows_in_order_of_epoch(setting, make, monkeypatch):
    # pages of three rows: runs and pages end in different places
    monkeypatch.setattr("db.measurements.archive.BLOCK_PAGE_ROWS", 3)
    setting.append([40, 10, 20], [-4.0, -1.0, float("nan")])
    setting.append([20, 30, 15], [-2.5, -3.5, -1.5], source="sa-2")
    setting.plan_id = setting.storage.catalogue.put_plan(setting.id, make.carriers[::-1], "turned").id
    setting.append([50, 5], [-5.0, -0.5])
    assert reported(setting, make.ever) == expected(setting.rows())
    assert [row[2] for row in reported(setting, Window(10, 40))] == [10, 15, 20, 20, 30]
    assert [row[2] for row in reported(setting, make.ever, source="sa-2")] == [15, 20, 30]
    assert [row[2] for row in reported(setting, make.ever, feeds_estimator_only=True)] == [5, 10, 20, 40, 50]
    assert reported(setting, Window(60, 70)) == []


def test_rows_of_one_source_under_one_plan_make_one_block(setting, make):
    setting.append(range(100))
    (block,) = setting.storage.archive.measurement_blocks(setting.id, make.ever)
    assert block.power_dbm.shape == (100, 3)
    for array in (block.power_dbm, block.epochs_us):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_sources_that_take_turns_row_by_row_make_few_blocks(setting, make):
    for source, first in (("sa-1", 0), ("sa-2", 1), ("sa-3", 2)):
        setting.append(range(first, 600, 3), source=source)
    blocks = list(setting.storage.archive.measurement_blocks(setting.id, make.ever))
    assert len(blocks) == 1
    assert reported(setting, make.ever) == expected(setting.rows())
    assert row_sources(blocks[0])[:4] == ["sa-1", "sa-2", "sa-3", "sa-1"]
    assert row_sources(blocks[0].part(100, 102)) == ["sa-2", "sa-3"]


def test_an_unknown_spacecraft_is_told_before_the_first_block(storage, make):
    with pytest.raises(NotFoundError) as caught:
        storage.archive.measurement_blocks("none", make.ever)
    assert caught.value.code == "spacecraft.unknown"


def test_memory_of_rows_after_an_epoch_does_not_grow_with_their_number(setting, monkeypatch):
    monkeypatch.setattr("db.measurements.archive.RECORD_PAGE_ROWS", 64)
    setting.append(range(10, 9_010))

    def peak_bytes(use):
        found = setting.storage.archive.measurements_after(setting.id, 0, 1 << 40)
        next(found)
        tracemalloc.start()
        assert use(found) == 8_999
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    assert 3 * peak_bytes(lambda found: sum(1 for _ in found)) < peak_bytes(lambda found: len(list(found)))
