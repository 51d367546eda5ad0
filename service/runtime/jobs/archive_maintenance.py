"""Maintenance of the archive: jobs that pack closed days and drop what is no longer kept."""

import logging
import time
from collections.abc import Iterable, Iterator, Sequence
from typing import TypeVar

from service.ports.storage import ARCHIVE, Clock, Storage, Term
from service.records.calibration import Alignment
from service.records.catalogue import LIVE_METHODS, Method
from service.records.epoch import US_PER_S, format_epoch
from service.records.operations.work import Job
from service.records.storage import LOGS, SERIES, RetentionConfig, RetiredRows, SealedPart, SealedResults, SealingConfig
from service.runtime.live.leadership import always

_LOG = logging.getLogger("soo.maintenance")
_DAY_US = 86_400 * US_PER_S
#: between two looks at the sizes of series, which read them through, s
SIZING_S = 3600.0
_Step = TypeVar("_Step", SealedPart, SealedResults, RetiredRows, int)


class MaintenanceDue:
    """Knows of which spacecraft days may be packed or dropped.

    Parameters
    ----------
    storage : Storage
        The archive.
    config : SealingConfig
        How often it is looked.
    turn : Term, optional
        Tells which spacecraft this process leads: those of others are theirs to maintain.
    """

    def __init__(self, storage: Storage, config: SealingConfig, turn: Term = always) -> None:
        self._storage, self._period_s, self._turn = storage, config.period_s, turn
        self._looked_s = time.monotonic()

    def due(self) -> Iterator[str]:
        """Yield, once a period, every spacecraft that this process leads, and the archive where it leads that."""
        if time.monotonic() - self._looked_s >= self._period_s:
            self._looked_s = time.monotonic()
            yield from (name for name in (*self._storage.archive.heads(), ARCHIVE) if self._turn(name))


class MaintenanceWork:
    """Work of the jobs that maintain the archive.

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
        self._storage, self._clock, self._sealing, self._retention = storage, clock, sealing, retention
        #: measurements and results sealed, and rows dropped of each series, since the start
        self.sealed_rows = self.sealed_results = 0
        self.dropped_rows = dict.fromkeys((*SERIES, *LOGS, "replays"), 0)
        #: when the sizes of a spacecraft's series were looked at, s of a clock that only counts
        self._sized_at_s: dict[str, float] = {}

    def __call__(self, job: Job) -> Iterator[float]:
        """Do all that is due of a spacecraft, or of what belongs to none, a transaction a step."""
        for _ in self.steps(job.spacecraft_id or None):
            # nobody knows how much there is
            yield 0.0
            # so that rows come in between
            time.sleep(self._sealing.pause_s)

    def steps(self, spacecraft_id: str | None) -> Iterator[object]:
        """Do all that is due of a spacecraft, or of the service (None); yield after each transaction."""
        if spacecraft_id is None:
            yield from self._logs_dropped(None, self._clock.system_us())
            return
        yield from self._dropped(spacecraft_id)
        yield from self._replays_dropped(spacecraft_id)
        yield from self._logs_dropped(spacecraft_id, self._clock.now_us(spacecraft_id))
        yield from self._sealed(spacecraft_id)

    def do_all(self) -> int:
        """Do all that is due of every spacecraft now, and return of how many that failed; the others are done."""
        failed = 0
        for name in (*(each.id for each in self._storage.catalogue.all_spacecraft()), None):
            try:
                for _ in self.steps(name):
                    pass
            except Exception:  # noqa: BLE001 a spacecraft that fails keeps no other one from it
                failed += 1
                _LOG.exception("archive maintenance of %s failed; what is due stays due", name or "the service")
        return failed

    def _dropped(self, spacecraft_id: str) -> Iterator[RetiredRows]:
        """Drop what is no longer kept; before days are packed, since what goes need not be."""
        is_sizing = time.monotonic() - self._sized_at_s.get(spacecraft_id, -SIZING_S) >= SIZING_S
        for series in SERIES:
            for before_us in self._bounds(spacecraft_id, series, is_sizing=is_sizing):
                for dropped in self._storage.archive.drop_before(spacecraft_id, series, before_us):
                    self.dropped_rows[series] += dropped.rows
                    yield dropped
        if is_sizing:
            self._sized_at_s[spacecraft_id] = time.monotonic()

    def _logs_dropped(self, spacecraft_id: str | None, now_us: int | None) -> Iterator[int]:
        """Drop old alarms and notes of a spacecraft, or of the service (None)."""
        for name in LOGS:
            if (days := self._retention.days(name)) and now_us is not None:
                log = self._storage.alarms if name == "alarms" else self._storage.notes
                yield from self._counted(name, log.drop_before(spacecraft_id, now_us - int(days * _DAY_US)))

    def _replays_dropped(self, spacecraft_id: str) -> Iterator[int]:
        """Drop old versions, and the rows of those that were deleted."""
        days = self._retention.replays_days
        before_us = self._clock.system_us() - int(days * _DAY_US) if days else None
        return self._counted("replays", self._storage.results.drop_replays(spacecraft_id, before_us))

    def _counted(self, name: str, steps: Iterable[int]) -> Iterator[int]:
        for rows in steps:
            self.dropped_rows[name] += rows
            yield rows

    def _bounds(self, spacecraft_id: str, series: str, *, is_sizing: bool) -> Iterator[int]:
        """Yield the epochs before which a series is not kept, by age first."""
        now_us = self._clock.now_us(spacecraft_id)
        if (days := self._retention.days(series)) and now_us is not None:
            yield now_us - int(days * _DAY_US)
        if (size_bytes := self._retention.size_bytes(series)) and is_sizing:
            before_us = self._storage.archive.fitting_us(spacecraft_id, series, size_bytes)
            if before_us is not None:
                yield before_us

    def _sealed(self, spacecraft_id: str) -> Iterator[object]:
        """Pack and summarise days that have ended and are quiet."""
        now_us, quiet_us = self._clock.now_us(spacecraft_id), int(self._sealing.quiet_s * US_PER_S)
        if now_us is None:
            return
        before_us = now_us - quiet_us
        for part in self._storage.archive.seal(spacecraft_id, before_us, self._clock.system_us() - quiet_us):
            self.sealed_rows += part.rows
            what = (part.rows, spacecraft_id, f"source {part.source}", format_epoch(part.first_epoch_us))
            _LOG.info("sealed %d rows of %s, %s, from %s", *what)
            yield part
        for sealed in self._storage.results.seal(spacecraft_id, before_us):
            self.sealed_results += sealed.rows
            whose = f"version {sealed.version}, {sealed.series}"
            what = (sealed.rows, spacecraft_id, whose, format_epoch(sealed.first_epoch_us))
            _LOG.info("sealed %d rows of %s, %s, from %s", *what)
            yield sealed


def runnable_methods(alignments: Sequence[Alignment]) -> tuple[Method, ...]:
    """Return the methods that run on every row since the newest alignment: those that it took references for.

    A method whose first calibration came after the alignment runs from then on, but rows before it never get its
    result; what waits for it waits for the other method's result too, for both are stored together.

    Parameters
    ----------
    alignments : sequence
        Of one spacecraft, newest first.
    """
    if not alignments:
        return ()
    named = alignments[0].calibration_by_method
    # alignments of versions that ran one method name none
    return tuple(method for method in LIVE_METHODS if method.value in named) or (Method.PAPER,)
