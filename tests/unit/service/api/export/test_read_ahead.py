"""Blocks read by another thread: all of them, in order, not too many at once, and none after the reader has gone."""

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from service.api.export.read_ahead import AHEAD_BYTES, read_ahead
from service.records.levels.measurement_block import MeasurementBlock

ROWS = AHEAD_BYTES // (4 * 16) // 4


class Source:
    """Gives blocks and remembers how many were taken, and whether it was let go."""

    def __init__(self, count: int, fault: Exception | None = None) -> None:
        self.taken = 0
        self.is_closed = False
        self._count = count
        self._fault = fault

    def blocks(self) -> Iterator[MeasurementBlock]:
        try:
            for number in range(self._count):
                self.taken += 1
                epochs_us = np.arange(ROWS) + number
                yield MeasurementBlock(("sa-1",), 1, epochs_us, np.zeros((ROWS, 16), np.float32))
            if self._fault is not None:
                raise self._fault
        finally:
            self.is_closed = True


def running() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "read-ahead"]


@pytest.mark.parametrize("count", [0, 1, 30])
def test_all_blocks_come_in_order(count):
    source = Source(count)
    assert [int(block.epochs_us[0]) for block in read_ahead(source.blocks())] == list(range(count))
    assert not running()


def test_what_waits_is_bounded():
    source = Source(30)
    blocks = read_ahead(source.blocks())
    for given in range(1, 7):
        next(blocks)
        # four blocks fill the line, one more may have been read that waits for room
        assert source.taken <= given + 5
    blocks.close()


def test_what_reading_raised_comes_after_the_blocks_before_it():
    blocks = read_ahead(Source(2, fault=ValueError("damaged")).blocks())
    assert len([next(blocks), next(blocks)]) == 2
    with pytest.raises(ValueError, match="damaged"):
        next(blocks)
    assert not running()


def test_a_reader_that_goes_ends_the_thread():
    source = Source(30)
    blocks = read_ahead(source.blocks())
    next(blocks)
    blocks.close()
    assert not running()
    assert source.is_closed
    assert source.taken < 30
