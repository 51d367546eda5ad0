"""``soo serve``: the service as one process.

Exit codes: 0 ended by a signal, 2 it could not start as told (settings, address, database); the reason is said.
"""

import json
import logging
import os
import signal
import socket
import sys
from contextlib import closing
from typing import Annotated, NoReturn

import typer
from pydantic import ValidationError

from service.errors import StorageError
from service.settings import Settings

# one thread a matrix product: two of them on small matrices cost far more than they give
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

#: wrong settings, or what they name cannot be had
EXIT_USAGE = 2


def serve(
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL of the archive.")] = None,
    host: Annotated[str | None, typer.Option(help="Address to listen on.")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on; 0 takes a free one and prints it.")] = None,
    clock: Annotated[
        str | None, typer.Option(help="`system`, or `data`: accepted epochs move the clock of simulated spacecraft.")
    ] = None,
) -> None:
    """Serve the REST interface; creates and migrates its database before it is ready."""
    for number in (signal.SIGTERM, signal.SIGINT):
        # ends a start; once uvicorn serves it stops gracefully first and raises the signal again
        signal.signal(number, lambda *_: sys.exit(0))
    settings = _settings({"database_url": database, "host": host, "port": port, "clock": clock})
    logging.basicConfig(
        level=settings.log_level.upper(), stream=sys.stderr, format="%(asctime)s %(levelname)s %(name)s %(message)s"
    )
    # tells of its own parts at every start
    logging.getLogger("alembic.runtime.plugins").setLevel(logging.WARNING)
    # the address comes first: where another service listens already, its database is not touched
    with closing(_listener(settings)) as listener:
        _serve(settings, listener)


def _settings(given: dict[str, str | int | None]) -> Settings:
    """Return the settings of options and environment, or end with what is wrong with them."""
    try:
        return Settings(**{name: value for name, value in given.items() if value is not None})  # type: ignore[arg-type] # pydantic validates
    except ValidationError as error:
        # the values themselves are left out: one of them is the key
        faults = error.errors(include_url=False, include_input=False, include_context=False)
        _refuse("; ".join(f"setting {'.'.join(map(str, fault['loc']))}: {fault['msg']}" for fault in faults))


def _listener(settings: Settings) -> socket.socket:
    """Return a socket bound to the address of the settings, or end."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((settings.host, settings.port))
    except OSError as error:
        listener.close()
        _refuse(f"cannot listen on {settings.host}:{settings.port}: {error.strerror}; choose another --port or --host")
    return listener


def _serve(settings: Settings, listener: socket.socket) -> None:
    """Listen, say where, and run until told to stop."""
    # imported here so that other commands start without the web framework and the database
    import uvicorn

    from service.api.server import StreamingServer
    from service.bootstrap import administrator_key, build_app, build_storage

    key, is_fresh = administrator_key(settings)
    try:
        storage = build_storage(settings)
    except (StorageError, ValueError) as error:
        _refuse(f"cannot use the database: {error}")
    app = build_app(settings, storage, key)
    if is_fresh:
        typer.echo(f"administrator's key, shown this once (set SOO_BOOTSTRAP_KEY to keep one): {key}", err=True)
    # one format of log lines, that of the service
    config = uvicorn.Config(app, log_config=None, access_log=False, timeout_graceful_shutdown=5, server_header=False)

    class AnnouncedServer(StreamingServer):
        """Says where it listens once it does."""

        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets)
            if self.started:
                name = f"[{settings.host}]" if ":" in settings.host else settings.host
                address = f"http://{name}:{listener.getsockname()[1]}"
                typer.echo(json.dumps({"url": address, "api": f"{address}/api/v1"}))
                sys.stdout.flush()

    AnnouncedServer(config, app).run(sockets=[listener])


def _refuse(message: str) -> NoReturn:
    """End with a message on standard error."""
    typer.echo(message, err=True)
    raise typer.Exit(EXIT_USAGE)
