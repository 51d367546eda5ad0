"""Blocks read by a thread of their own while those before them are written."""

from collections import deque
from collections.abc import Iterator
from threading import Condition, Thread

from service.records.levels.measurement_block import MeasurementBlock

#: powers that wait to be written; a group of rows of Parquet is written in one go and takes as much meanwhile
AHEAD_BYTES = 4 << 20


def read_ahead(blocks: Iterator[MeasurementBlock]) -> Iterator[MeasurementBlock]:
    """Yield the same blocks, the next ones read meanwhile, as many as fit ``AHEAD_BYTES`` and one.

    Reading unpacks and writing formats without Python's lock, so both run at once.
    """
    line = _Line(blocks)
    line.start()
    try:
        while (block := line.next_block()) is not None:
            yield block
    finally:
        line.stop()


class _Line(Thread):
    """Blocks on their way from one thread to another."""

    def __init__(self, blocks: Iterator[MeasurementBlock]) -> None:
        super().__init__(name="read-ahead", daemon=True)
        self._blocks = blocks
        self._waiting: deque[MeasurementBlock] = deque()
        self._bytes = 0
        self._changed = Condition()
        self._is_done = False
        self._is_unwanted = False
        self._fault: BaseException | None = None

    def run(self) -> None:
        """Read until nobody wants more."""
        try:
            for block in self._blocks:
                if not self._add(block):
                    break
        except BaseException as fault:  # noqa: BLE001 raised to the reader of the blocks
            self._fault = fault
        with self._changed:
            self._is_done = True
            self._changed.notify_all()

    def next_block(self) -> MeasurementBlock | None:
        """Return the next block, None after the last; what reading raised is raised here."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._is_done)
            if not self._waiting:
                if self._fault is not None:
                    raise self._fault
                return None
            block = self._waiting.popleft()
            self._bytes -= block.power_dbm.nbytes
            self._changed.notify_all()
            return block

    def stop(self) -> None:
        """Let the thread end and wait for it: nothing of the archive is in use afterwards."""
        with self._changed:
            self._is_unwanted = True
            self._changed.notify_all()
        self.join()

    def _add(self, block: MeasurementBlock) -> bool:
        """Queue a block when there is room; False when nobody wants it."""
        with self._changed:
            self._changed.wait_for(lambda: self._bytes < AHEAD_BYTES or self._is_unwanted)
            self._waiting.append(block)
            self._bytes += block.power_dbm.nbytes
            self._changed.notify_all()
            return not self._is_unwanted
