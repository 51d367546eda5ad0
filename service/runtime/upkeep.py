"""Upkeep of the archive: one thread that seals closed days and drops what is older than is kept.

Work comes in short transactions with pauses between them, so that rows of front ends never wait for long. A fault is
logged and the work tried again at the next look: nothing depends on when it is done.
"""

import logging
import threading
from collections.abc import Iterable, Iterator
from typing import TypeVar

from service.ports import Clock, Storage
from service.records.archive_upkeep import SERIES, Dropped, RetentionConfig, SealedPart, SealingConfig
from service.records.epoch import US_PER_S, format_epoch

_LOG = logging.getLogger("soo.upkeep")
_DAY_US = 86_400 * US_PER_S
_Step = TypeVar("_Step", SealedPart, Dropped)


class Upkeep:
    """Seals days and drops rows while the service runs.

    Parameters
    ----------
    storage : Storage
        The archive.
    clock : Clock
        Tells which days of a spacecraft have ended.
    sealing : SealingConfig
        When days are packed.
    retention : RetentionConfig
        How long series are kept.
    """

    def __init__(self, storage: Storage, clock: Clock, sealing: SealingConfig, retention: RetentionConfig) -> None:
        self._storage = storage
        self._clock = clock
        self._sealing = sealing
        self._retention = retention
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        #: rows sealed, and rows dropped of each series, since the start
        self.sealed_rows = 0
        self.dropped_rows = dict.fromkeys(SERIES, 0)
        #: looks at a spacecraft that failed, since the start
        self.failed_looks = 0

    def start(self) -> None:
        """Look after the archive until stopped."""
        self._thread = threading.Thread(target=self._run, name="soo-upkeep", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Finish the transaction in hand and end the thread."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()

    def look_once(self) -> None:
        """Do all that is due now; a spacecraft whose archive fails does not keep the others from it."""
        for spacecraft in self._storage.catalogue.all_spacecraft():
            if self._stopping.is_set():
                return
            try:
                self._look_at(spacecraft.id)
            except Exception:  # noqa: BLE001 the thread outlives every fault; what is due stays due
                self.failed_looks += 1
                _LOG.exception("upkeep of the archive of %s failed; it is tried again", spacecraft.id)

    def _run(self) -> None:
        while not self._stopping.wait(self._sealing.period_s):
            try:
                self.look_once()
            except Exception:  # noqa: BLE001 as above
                _LOG.exception("upkeep of the archive failed; it is tried again")

    def _look_at(self, spacecraft_id: str) -> None:
        now_us = self._clock.now_us(spacecraft_id)
        if now_us is None:
            return
        # dropped first: what goes need not be packed
        for series in SERIES:
            for dropped in self._paced(self._due_to_drop(spacecraft_id, series, now_us)):
                self.dropped_rows[series] += dropped.rows
        quiet_us = int(self._sealing.quiet_s * US_PER_S)
        parts = self._storage.archive.seal(spacecraft_id, now_us - quiet_us, self._clock.system_us() - quiet_us)
        for part in self._paced(parts):
            self._count(spacecraft_id, part)

    def _due_to_drop(self, spacecraft_id: str, series: str, now_us: int) -> Iterator[Dropped]:
        """Yield what retention takes away, by age first."""
        archive = self._storage.archive
        if days := self._retention.days(series):
            yield from archive.drop_before(spacecraft_id, series, now_us - int(days * _DAY_US))
        if size_bytes := self._retention.size_bytes(series):
            before_us = archive.fitting_us(spacecraft_id, series, size_bytes)
            if before_us is not None:
                yield from archive.drop_before(spacecraft_id, series, before_us)

    def _paced(self, steps: Iterable[_Step]) -> Iterator[_Step]:
        """Yield steps with pauses until the thread is to stop."""
        for step in steps:
            yield step
            if self._stopping.wait(self._sealing.pause_s):
                return

    def _count(self, spacecraft_id: str, part: SealedPart) -> None:
        self.sealed_rows += part.rows
        _LOG.info(
            "sealed %d rows of %s, source %s, from %s",
            part.rows,
            spacecraft_id,
            part.source,
            format_epoch(part.first_epoch_us),
        )
