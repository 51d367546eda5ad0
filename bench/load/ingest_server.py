"""The service of the ingest benchmark: the real application and server, over the real archive or over another.

Run ``python -m bench.load.ingest_server --archive durable --database sqlite:///file.db``. It announces its address as
``soo serve`` does. The endpoint is always the same. With ``--archive none`` rows count as stored the moment they
come.
"""

import argparse
import json
import os
import socket
from concurrent.futures import Future
from typing import Any

import uvicorn

from service.api.server_process import StreamingServer
from service.composition.bootstrap import build_app, build_storage
from service.composition.settings import Settings
from service.records.levels.measurement import BatchReceipt, MeasurementBatch
from service.runtime.jobs.job_runner import calm_collector


class NoArchive:
    """An archive that answers at once and keeps no rows; everything else is asked of the real one.

    The first batch of each source is stored, so that clock and sources know something.

    Parameters
    ----------
    archive : Any
        The real one.
    """

    def __init__(self, archive: Any) -> None:
        self._archive = archive
        self._sources: set[str] = set()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._archive, name)

    def append_measurements(self, batch: MeasurementBatch) -> "Future[BatchReceipt]":
        """Count the rows of a batch as stored."""
        if batch.source not in self._sources:
            self._sources.add(batch.source)
            stored: Future[BatchReceipt] = self._archive.append_measurements(batch)
            return stored
        future: Future[BatchReceipt] = Future()
        future.set_result(BatchReceipt(len(batch.epochs_us), 0, 0, ()))
        return future

    def journal(self, spacecraft_id: str, after: int, limit: int) -> list[Any]:  # noqa: ARG002 - signature of the port
        """Return nothing: no row was stored."""
        return []


def main() -> None:
    """Serve until told to stop."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--archive", choices=("durable", "none"), required=True)
    parser.add_argument("--database", required=True)
    options = parser.parse_args()
    os.environ |= {"SOO_DATABASE_URL": options.database, "SOO_CLOCK": "data"}
    settings = Settings.model_validate({})
    storage = build_storage(settings)
    if options.archive == "none":
        no_archive: Any = NoArchive(storage.archive)
        storage.archive = no_archive
    app = build_app(settings, storage)
    # as the service itself does
    calm_collector()
    listener = socket.socket()
    listener.bind(("127.0.0.1", 0))
    # bound sockets accept connections once the server listens; the client tries again until then
    print(json.dumps({"url": f"http://127.0.0.1:{listener.getsockname()[1]}"}), flush=True)
    config = uvicorn.Config(app, log_config=None, access_log=False, server_header=False)
    StreamingServer(config, app).run(sockets=[listener])


if __name__ == "__main__":
    main()
