"""Reference for group commit: each request in a transaction and a commit of its own.

The endpoint and all statements are those of the product. In place of the one writer that takes along what waits, a
request is stored by a thread of a pool over a connection of its own, as services on a thread pool do.
"""

import time
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from threading import local
from typing import Any

from sqlalchemy import Engine, event

from db.connection.engines import open_engines
from db.encoding.segments import SegmentCache
from db.measurements.ingest import store_batch
from db.measurements.prepared_batch import PreparedBatch, prepare
from service.records.levels.measurement import BatchReceipt, MeasurementBatch

#: as many as the framework's own pool has
THREADS = 40


def slow_down(engine: Engine, sync_s: float) -> None:
    """Let every commit of an engine take longer, as on a disk that takes so long to sync."""
    if sync_s:
        # before the COMMIT itself, while the lock is held
        event.listen(engine, "commit", lambda _: time.sleep(sync_s), insert=True)


class CommitPerRequest:
    """An archive that commits every batch by itself; everything else is asked of the real one.

    Parameters
    ----------
    archive : Any
        The real one.
    url : str
        Its database.
    sync_s : float
        What each commit takes longer.
    """

    def __init__(self, archive: Any, url: str, sync_s: float) -> None:
        self._archive = archive
        self._url = url
        self._sync_s = sync_s
        self._pool = ThreadPoolExecutor(THREADS)
        self._of_thread = local()
        self._cache = SegmentCache()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._archive, name)

    def append_measurements(self, batch: MeasurementBatch) -> "Future[BatchReceipt]":
        """Store the rows of a batch; the future resolves after their own commit."""
        key = self._archive._database.key(batch.spacecraft_id)  # noqa: SLF001 - no port tells keys
        prepared = prepare(key, batch)
        return self._pool.submit(partial(self._store, prepared))

    def _store(self, prepared: PreparedBatch) -> BatchReceipt:
        if not hasattr(self._of_thread, "engine"):
            self._of_thread.engine = open_engines(self._url).write
            slow_down(self._of_thread.engine, self._sync_s)
        with self._of_thread.engine.begin() as connection:
            return store_batch(connection, prepared, self._cache)
