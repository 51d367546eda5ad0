"""The server: uvicorn, that ends live streams when it is told to stop.

uvicorn waits for answers in progress, and a stream is one that never ends by itself.
"""

import socket

import uvicorn
from fastapi import FastAPI

from service.api.open_streams import OpenStreams


class StreamingServer(uvicorn.Server):
    """A server whose graceful stop does not wait for live streams.

    Parameters
    ----------
    config : uvicorn.Config
        As for uvicorn.
    app : FastAPI
        The application of the config.
    """

    def __init__(self, config: uvicorn.Config, app: FastAPI) -> None:
        super().__init__(config)
        self._app = app

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End live streams, then stop as uvicorn does."""
        streams: OpenStreams = self._app.state.open_streams
        streams.close()
        await super().shutdown(sockets)
