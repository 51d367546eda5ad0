"""Bounds of the epochs that a spacecraft's clock accepts, cached for a second where the clock queries the database.

Under the data clock the present is the newest stored epoch, which only grows: what was accepted under a remembered one
is accepted under the present one. A caller that is about to refuse an epoch asks for the present bounds first.
"""

import asyncio
from typing import NamedTuple

from starlette.concurrency import run_in_threadpool

from service.api.context.dependencies import Limits
from service.pipeline.ingest_screening import EpochBounds, data_bounds, system_bounds
from service.ports import Archive, Clock
from service.records.epoch import US_PER_S


class _Known(NamedTuple):
    """Reading of a spacecraft's clock and retention limit."""

    read_at_us: int
    is_data: bool
    now_us: int | None
    #: below it rows were dropped
    kept_from_us: int


class EpochLimits:
    """Bounds of epochs by spacecraft.

    Parameters
    ----------
    clock : Clock
        Clock of the service.
    limits : Limits
        Tolerances.
    archive : Archive
        Tells what it has dropped.
    """

    def __init__(self, clock: Clock, limits: Limits, archive: Archive) -> None:
        self._clock = clock
        self._archive = archive
        self._limits = limits
        self._known: dict[str, _Known] = {}
        #: spacecraft that are just asked about
        self._asking: dict[str, asyncio.Task[EpochBounds]] = {}

    async def known(self, spacecraft_id: str) -> EpochBounds:
        """Return bounds at most a second old."""
        known = self._known.get(spacecraft_id)
        now_us = self._clock.system_us()
        # before its first row nothing bounds a spacecraft, so that is never remembered
        if known is None or known.now_us is None or not 0 <= now_us - known.read_at_us < US_PER_S:
            return await self._asked_together(spacecraft_id)
        return self._bounds(known if known.is_data else known._replace(now_us=now_us))

    async def present(self, spacecraft_id: str) -> EpochBounds:
        """Return the bounds of this moment."""
        known = await run_in_threadpool(self._read, spacecraft_id)
        self._known[spacecraft_id] = known
        return self._bounds(known)

    def forget(self, spacecraft_id: str) -> None:
        """Forget a spacecraft that was changed: it may live under another clock now."""
        self._known.pop(spacecraft_id, None)
        self._asking.pop(spacecraft_id, None)

    async def _asked_together(self, spacecraft_id: str) -> EpochBounds:
        """Return what one asks for all that want it at once; each by itself would wait for a thread and the others."""
        asking = self._asking.get(spacecraft_id)
        if asking is None:
            asking = self._asking[spacecraft_id] = asyncio.ensure_future(self.present(spacecraft_id))
            asking.add_done_callback(lambda task: self._asked(spacecraft_id, task))
        # who gives up does not spoil it for the others
        return await asyncio.shield(asking)

    def _asked(self, spacecraft_id: str, task: "asyncio.Task[EpochBounds]") -> None:
        if self._asking.get(spacecraft_id) is task:
            del self._asking[spacecraft_id]
        if not task.cancelled():
            # looked at, in case nobody waits any more
            task.exception()

    def _read(self, spacecraft_id: str) -> _Known:
        """Ask the clock and the archive."""
        clock, kept_from_us = self._clock, self._archive.kept_from_us(spacecraft_id, "measurements")
        return _Known(clock.system_us(), clock.is_data(spacecraft_id), clock.now_us(spacecraft_id), kept_from_us)

    def _bounds(self, known: _Known) -> EpochBounds:
        """Return what the clock's word means for epochs; what was dropped does not come in again."""
        limits = self._limits
        if known.is_data or known.now_us is None:
            bounds = data_bounds(known.now_us, limits.future_tolerance_data_s, limits.retention_s)
        else:
            bounds = system_bounds(known.now_us, limits.future_tolerance_s, limits.late_after_s, limits.retention_s)
        return bounds._replace(earliest_us=max(bounds.earliest_us, known.kept_from_us))
