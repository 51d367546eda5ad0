"""The server: uvicorn as this service wants it, that ends live streams when it is told to stop.

uvicorn waits for answers in progress, and a stream is one that never ends by itself.
"""

import asyncio
import socket
import ssl
import sys
from functools import partial

import uvicorn
from fastapi import FastAPI

from service.api.limits.http_protocol import HEAD_TIMEOUT_S, BoundedProtocol
from service.api.stream.event_stream import OpenStreams


def server_config(
    app: FastAPI,
    *,
    certificate: str | None = None,
    key: str | None = None,
    trusted_proxies: str | None = None,
    request_timeout_s: float = BoundedProtocol.request_timeout_s,
) -> uvicorn.Config:
    """Return how the application is served.

    Parameters
    ----------
    app : FastAPI
        The application.
    certificate, key : str or None
        PEM files of TLS; both or none.
    trusted_proxies : str or None
        Addresses or networks, by commas, whose X-Forwarded headers are believed; None = nobody's.
    request_timeout_s : float
        A request must be complete within this.
    """
    of_all = {"request_timeout_s": request_timeout_s, "connections_open": app.state.connections}
    protocol = type("Protocol", (BoundedProtocol,), of_all)
    return uvicorn.Config(
        app,
        http=protocol,
        ws="none",
        # one format of log lines, that of the service
        log_config=None,
        access_log=False,
        timeout_graceful_shutdown=5,
        server_header=False,
        # of every answer, those outside of the application included
        headers=[("X-Content-Type-Options", "nosniff")],
        ssl_certfile=certificate,
        ssl_keyfile=key,
        # uvicorn would believe 127.0.0.1 unasked, and whatever stands in the environment
        proxy_headers=bool(trusted_proxies),
        forwarded_allow_ips=trusted_proxies or "",
    )


#: a thread that computes releases the interpreter after this time, s; with Python's 5 ms two viewers of samples made
#: `status`, which takes the interpreter some twenty times, twelve times as slow
_SWITCH_S = 0.001


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

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen; a connection that does not finish its TLS handshake ends as soon as one without a head."""
        sys.setswitchinterval(_SWITCH_S)
        loop = asyncio.get_running_loop()
        if self.config.ssl is not None:
            # some builds of Python leave it to the system's library
            self.config.ssl.minimum_version = ssl.TLSVersion.TLSv1_2
            # uvicorn passes no such option on
            create = partial(loop.create_server, ssl_handshake_timeout=HEAD_TIMEOUT_S)
            loop.create_server = create  # type: ignore[method-assign]
        await super().startup(sockets)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End live streams, then stop as uvicorn does."""
        streams: OpenStreams = self._app.state.open_streams
        streams.close()
        await super().shutdown(sockets)
