"""Upkeep of the archive: one thread that seals and summarises closed days and drops what is older than is kept.

Work comes in short transactions with pauses between them, so that rows of front ends never wait for long. A fault is
logged and the work tried again at the next look: nothing depends on when it is done.
"""

import logging
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from service.ports import ARCHIVE, Clock, Storage, Term
from service.records.epoch import US_PER_S, format_epoch
from service.records.storage.archive_maintenance import (
    LOGS,
    SERIES,
    RetentionConfig,
    RetiredRows,
    SealedPart,
    SealedResults,
    SealingConfig,
)
from service.runtime.jobs.archive_analysis import runnable_methods
from service.runtime.live.leadership import always

_LOG = logging.getLogger("soo.maintenance")
_DAY_US = 86_400 * US_PER_S
#: between two looks at the sizes of series, which read them through, s
SIZING_S = 3600.0
_Step = TypeVar("_Step", SealedPart, SealedResults, RetiredRows, int)


class ArchiveMaintenance:
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
    turn : Term, optional
        Tells which spacecraft this process leads: those of others are theirs to maintain.
    """

    def __init__(
        self,
        storage: Storage,
        clock: Clock,
        sealing: SealingConfig,
        retention: RetentionConfig,
        turn: Term = always,
    ) -> None:
        self._turn = turn
        self._storage = storage
        self._clock = clock
        self._sealing = sealing
        self._retention = retention
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        #: measurements and results sealed, and rows dropped of each series, since the start
        self.sealed_rows = self.sealed_results = 0
        #: days of a method that were summarised, since the start
        self.summarised_days = 0
        self.dropped_rows = dict.fromkeys((*SERIES, *LOGS, "replays"), 0)
        #: when the sizes of a spacecraft's series were looked at, s of a clock that only counts
        self._sized_at_s: dict[str, float] = {}
        #: looks at a spacecraft that failed, since the start
        self.failed_polls = 0

    def start(self) -> None:
        """Start the maintenance thread, which runs until stopped."""
        self._thread = threading.Thread(target=self._run, name="soo-maintenance", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Finish the transaction in hand and end the thread."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()

    def poll_once(self) -> None:
        """Do all that is due now of what this process leads; a spacecraft that fails keeps no other one from it."""
        for spacecraft in self._storage.catalogue.all_spacecraft():
            if self._stopping.is_set():
                return
            if not self._turn(spacecraft.id):
                continue
            with self._guarded(spacecraft.id):
                self._drop(spacecraft.id)
                self._drop_replays(spacecraft.id)
                self._drop_logs(spacecraft.id, self._clock.now_us(spacecraft.id))
                self._seal(spacecraft.id)
                self._summarise(spacecraft.id)
        if not self._turn(ARCHIVE):
            return
        with self._guarded("the service"):
            self._drop_logs(None, self._clock.system_us())

    @contextmanager
    def _guarded(self, whose: str) -> Iterator[None]:
        """Outlive every fault; what is due stays due."""
        try:
            yield
        except Exception:  # noqa: BLE001 as the docstring says
            self.failed_polls += 1
            _LOG.exception("archive maintenance of %s failed; it is retried", whose)

    def _run(self) -> None:
        while not self._stopping.wait(self._sealing.period_s):
            try:
                self.poll_once()
            except Exception:  # noqa: BLE001 as above
                _LOG.exception("archive maintenance failed; it is retried")

    def _drop(self, spacecraft_id: str) -> None:
        """Drop what is no longer kept; before days are packed, since what goes need not be."""
        is_sizing = time.monotonic() - self._sized_at_s.get(spacecraft_id, -SIZING_S) >= SIZING_S
        for series in SERIES:
            for before_us in self._bounds(spacecraft_id, series, is_sizing=is_sizing):
                for dropped in self._paced(self._storage.archive.drop_before(spacecraft_id, series, before_us)):
                    self.dropped_rows[series] += dropped.rows
        if is_sizing:
            self._sized_at_s[spacecraft_id] = time.monotonic()

    def _drop_logs(self, spacecraft_id: str | None, now_us: int | None) -> None:
        """Drop old alarms and notes of a spacecraft, or of the service (None)."""
        for name in LOGS:
            if (days := self._retention.days(name)) and now_us is not None:
                log = self._storage.alarms if name == "alarms" else self._storage.notes
                for rows in self._paced(log.drop_before(spacecraft_id, now_us - int(days * _DAY_US))):
                    self.dropped_rows[name] += rows

    def _drop_replays(self, spacecraft_id: str) -> None:
        """Drop old versions, and the rows of those that were deleted."""
        days = self._retention.replays_days
        before_us = self._clock.system_us() - int(days * _DAY_US) if days else None
        for rows in self._paced(self._storage.results.drop_replays(spacecraft_id, before_us)):
            self.dropped_rows["replays"] += rows

    def _bounds(self, spacecraft_id: str, series: str, *, is_sizing: bool) -> Iterator[int]:
        """Yield the epochs before which a series is not kept, by age first."""
        now_us = self._clock.now_us(spacecraft_id)
        if (days := self._retention.days(series)) and now_us is not None:
            yield now_us - int(days * _DAY_US)
        if (size_bytes := self._retention.size_bytes(series)) and is_sizing:
            before_us = self._storage.archive.fitting_us(spacecraft_id, series, size_bytes)
            if before_us is not None:
                yield before_us

    def _seal(self, spacecraft_id: str) -> None:
        """Pack days that have ended and are quiet."""
        now_us, quiet_us = self._clock.now_us(spacecraft_id), int(self._sealing.quiet_s * US_PER_S)
        if now_us is None:
            return
        parts = self._storage.archive.seal(spacecraft_id, now_us - quiet_us, self._clock.system_us() - quiet_us)
        for part in self._paced(parts):
            self._count(spacecraft_id, part)
        for sealed in self._paced(self._storage.results.seal(spacecraft_id, now_us - quiet_us)):
            self.sealed_results += sealed.rows
            _LOG.info(
                "sealed %d %s rows of %s, version %s, from %s",
                sealed.rows,
                sealed.series,
                spacecraft_id,
                sealed.version,
                format_epoch(sealed.first_epoch_us),
            )

    def _summarise(self, spacecraft_id: str) -> None:
        """Summarise closed days, and store up to where every row has its results."""
        now_us, quiet_us = self._clock.now_us(spacecraft_id), int(self._sealing.quiet_s * US_PER_S)
        if now_us is None:
            return
        results = self._storage.results
        for days in self._paced(results.complete_summaries(spacecraft_id, now_us - quiet_us)):
            self.summarised_days += days
        results.mark_complete(spacecraft_id, runnable_methods(self._storage, spacecraft_id))

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
