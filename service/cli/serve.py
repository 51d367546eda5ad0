"""``soo serve``: the service as one process."""

import json
import logging
import os
import socket
import sys
from typing import Annotated

import typer

from service.settings import Settings

# one thread a matrix product: two of them on small matrices cost far more than they give
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def serve(
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL of the archive.")] = None,
    host: Annotated[str | None, typer.Option(help="Address to listen on.")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on; 0 takes a free one and prints it.")] = None,
    clock: Annotated[
        str | None, typer.Option(help="`system`, or `data`: accepted epochs move the clock of simulated spacecraft.")
    ] = None,
) -> None:
    """Serve the REST interface; creates and migrates its database before it is ready."""
    given = {"database_url": database, "host": host, "port": port, "clock": clock}
    settings = Settings(**{name: value for name, value in given.items() if value is not None})  # type: ignore[arg-type] # pydantic validates
    logging.basicConfig(
        level=settings.log_level.upper(), stream=sys.stderr, format="%(asctime)s %(levelname)s %(name)s %(message)s"
    )
    _serve(settings)


def _serve(settings: Settings) -> None:
    """Listen, say where, and run until told to stop."""
    # imported here so that other commands start without the web framework and the database
    import uvicorn

    from service.api.server import StreamingServer
    from service.bootstrap import administrator_key, build_app, build_storage

    key, is_fresh = administrator_key(settings)
    app = build_app(settings, build_storage(settings), key)
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((settings.host, settings.port))
        except OSError as error:
            typer.echo(f"cannot listen on {settings.host}:{settings.port}: {error}; choose another --port", err=True)
            raise typer.Exit(2) from error
        port = listener.getsockname()[1]
        if is_fresh:
            typer.echo(f"administrator's key, shown this once (set SOO_BOOTSTRAP_KEY to keep one): {key}", err=True)
        config = uvicorn.Config(
            app, log_level=settings.log_level, access_log=False, timeout_graceful_shutdown=5, server_header=False
        )

        class AnnouncedServer(StreamingServer):
            """Says where it listens once it does."""

            async def startup(self, sockets: list[socket.socket] | None = None) -> None:
                await super().startup(sockets)
                if self.started:
                    address = f"http://{settings.host}:{port}"
                    typer.echo(json.dumps({"url": address, "api": f"{address}/api/v1"}))
                    sys.stdout.flush()

        AnnouncedServer(config, app).run(sockets=[listener])
