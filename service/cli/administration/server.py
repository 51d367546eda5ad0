"""``soo init`` and ``soo serve``: a folder from which a service starts, and the service itself."""

import gc
import glob
import json
import logging
import os
import shlex
import signal
import socket
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.command_group import end
from service.cli.operation.connection import JsonOption
from service.cli.operation.profile import ProfileError, write_profile
from service.errors import StorageError
from service.records.storage import sqlite_url
from service.runtime.log_format import write_log

if TYPE_CHECKING:
    from fastapi import FastAPI

    from service.api.context import ApiContext
    from service.api.server_process import StreamingServer
    from service.composition.settings import Settings
    from service.ports.storage import Storage


_UNIT = """\
[Unit]
Description=SOO, attitude of geostationary satellites from carrier powers
After=network-online.target

[Service]
EnvironmentFile={settings}
ExecStart="{python}" -m service serve
WorkingDirectory={folder}
Restart=on-failure
UMask=0077
NoNewPrivileges=yes
ProtectSystem=full
PrivateTmp=yes
MemoryMax=4G
TasksMax=512
# a worker process that takes too much ends alone, and its job with it
OOMPolicy=continue

[Install]
WantedBy=default.target
"""


def init(
    folder: Annotated[Path, typer.Argument(help="Folder to make; not there yet, or empty.", file_okay=False)],
    *,
    port: Annotated[int, typer.Option(min=1, max=65_535, help="Port of the service on 127.0.0.1.")] = 8000,
    profile: Annotated[bool, typer.Option(help="Make it the service of your profile.")] = True,
    as_json: JsonOption = False,
) -> None:
    """Make a folder from which a service starts: settings, archive, first key, systemd unit."""
    folder, url = folder.resolve(), f"http://127.0.0.1:{port}"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if any(folder.iterdir()):
            end(f"{folder} is not empty; name a folder that is not there yet")
        folder.chmod(0o700)
        made = _files(folder, port)
    except OSError as error:
        end(f"{error.filename or folder} cannot be written: {error.strerror}", cause=error)
    if profile:
        try:
            made["profile"] = str(write_profile(url, Path(made["key_file"]), None))
        except (ProfileError, OSError) as error:
            typer.echo(f"the profile stays as it is: {error}", err=True)
    if as_json:
        typer.echo(json.dumps({"service": url, **made}))
        return
    typer.echo(f"made {', '.join(made.values())}")
    typer.echo(f"start it here:   set -a; . {shlex.quote(made['settings'])}; {_soo()} serve")
    typer.echo(f"or for good:     systemctl --user enable --now {shlex.quote(made['unit'])}")
    typer.echo(f"then:            console {url}/console/, sign in with the key in {made['key_file']}")
    typer.echo("and:             soo put spacecraft FILE")


def _files(folder: Path, port: int) -> dict[str, str]:
    """Write the files and return their names."""
    # the database costs time that other commands need not pay
    from service.composition.bootstrap import build_storage, first_administrator
    from service.composition.settings import Settings

    database_url = sqlite_url(str(folder / "soo.db"))
    # a key of the environment is another service's
    settings = Settings.model_validate({"database_url": database_url, "bootstrap_key": None})
    storage = build_storage(settings)
    try:
        key_file = first_administrator(settings, storage)
    finally:
        storage.close()
    environment, unit = folder / "soo.env", folder / "soo.service"
    stated = {"SOO_DATABASE_URL": database_url, "SOO_HOST": "127.0.0.1", "SOO_PORT": str(port)}
    environment.write_text("".join(f"{name}={shlex.quote(value)}\n" for name, value in stated.items()))
    # systemd reads a per cent sign as the begin of a name
    # and the file of settings as a pattern
    places = {"settings": glob.escape(str(environment)), "folder": folder, "python": sys.executable}
    unit.write_text(_UNIT.format(**{name: str(path).replace("%", "%%") for name, path in places.items()}))
    return {"settings": str(environment), "key_file": str(key_file), "unit": str(unit)}


def _soo() -> str:
    program = Path(sys.executable).with_name("soo")
    return shlex.quote(str(program)) if program.exists() else f"{shlex.quote(sys.executable)} -m service"


_LOG = logging.getLogger("soo.serve")

# one thread a matrix product: two of them on small matrices cost far more than they give
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

#: a database server that is away at the start is waited for so long
_PATIENCE_S = 30.0
#: between two looks at the database
_POLL_S = 1.0


def serve(
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL of the archive.")] = None,
    host: Annotated[str | None, typer.Option(help="Address to listen on.")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on; 0 takes a free one and prints it.")] = None,
    clock: Annotated[
        str | None, typer.Option(help="`system`, or `data`: accepted epochs move the clock of simulated spacecraft.")
    ] = None,
    tls_certificate: Annotated[
        str | None, typer.Option(help="Certificate chain, PEM; with it HTTPS is served.")
    ] = None,
    tls_key: Annotated[str | None, typer.Option(help="Private key of the certificate, PEM.")] = None,
    *,
    http: Annotated[bool, typer.Option(help="Serve the interface; without it estimate only, beside others.")] = True,
    estimator: Annotated[
        bool | None, typer.Option(help="Estimate a share of the spacecraft; without it store rows and answer.")
    ] = None,
) -> None:
    """Serve the REST interface; makes a new archive where there is none."""
    for number in (signal.SIGTERM, signal.SIGINT):
        # ends a start; once uvicorn serves it stops gracefully first and raises the signal again
        signal.signal(number, lambda *_: sys.exit(0))
    given = {"database_url": database, "host": host, "port": port, "clock": clock, "estimator": estimator}
    settings = _settings({**given, "tls_certificate": tls_certificate, "tls_key": tls_key})
    _check_tls(settings)
    write_log(settings.log_level, settings.log_format)
    if not http:
        _estimate(settings)
        return
    # the address comes first: where another service listens already, its database is not touched
    with closing(_listener(settings)) as listener:
        _serve(settings, listener)


def _settings(given: dict[str, str | int | bool | None]) -> "Settings":
    """Return the settings of options and environment, or end with what is wrong with them."""
    # pydantic costs more than the command line itself
    from pydantic import ValidationError
    from pydantic_settings import SettingsError

    from service.composition.settings import Settings
    from service.records.field_faults import faults_text

    try:
        return Settings(**{name: value for name, value in given.items() if value is not None})  # type: ignore[arg-type] # pydantic validates
    except ValidationError as error:
        end(f"settings: {faults_text(error.errors(include_url=False, include_input=False))}")
    except (SettingsError, OSError, UnicodeDecodeError) as error:
        end(f"settings cannot be read: {error}")


def _check_tls(settings: "Settings") -> None:
    """End unless certificate and key are both left out, or belong together."""
    certificate, key = settings.tls_certificate, settings.tls_key
    if certificate is None and key is None:
        return
    if certificate is None or key is None:
        end("--tls-certificate and --tls-key go together: one is missing")
    # loads OpenSSL, which a service without a certificate does not need
    import ssl

    try:
        # an encrypted key is refused rather than asked for on a terminal that a service does not have
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key, password="")
    except (OSError, ssl.SSLError) as error:
        end(f"cannot use certificate {certificate} with key {key}: {error.strerror or error}")


def _listener(settings: "Settings") -> socket.socket:
    """Return a socket bound to the address of the settings, or end."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((settings.host, settings.port))
    except OSError as error:
        listener.close()
        end(f"cannot listen on {settings.host}:{settings.port}: {error.strerror}; choose another --port or --host")
    return listener


def _serve(settings: "Settings", listener: socket.socket) -> None:
    """Listen, say where, and run until told to stop; begin again on an archive that was put in the place of ours."""
    # imported here so that other commands start without the web framework and the database
    from service.composition.bootstrap import build_app, first_administrator, watch_file
    from service.runtime.jobs.job_runner import calm_collector

    is_announced = False
    while True:
        storage = _opened(settings)
        try:
            key_file = first_administrator(settings, storage)
        except OSError as error:
            end(f"cannot write the administrator's key to {error.filename}: {error.strerror}; set SOO_BOOTSTRAP_KEY")
        watch = watch_file(settings)
        server = _server(settings, build_app(settings, storage), None if is_announced else listener)
        if not is_announced:
            calm_collector()
            gc.enable()
        if key_file is not None:
            _LOG.warning(
                "the administrator's key was written to %s: store it in a safe place, then delete the file", key_file
            )
        replaced = Event()
        if watch is not None:
            Thread(target=_stop_when, args=(watch.is_to_be_reopened, server, replaced), daemon=True).start()
        server.run(sockets=[listener.dup()])
        if not replaced.is_set():
            return
        _LOG.warning("the archive's files were replaced; the service restarts on the new files")
        is_announced = True


def _estimate(settings: "Settings") -> None:
    """Estimate, alarm, release and maintain without an interface until told to stop."""
    if not settings.database_url.startswith("postgresql"):
        end("--no-http is for estimators beside services on a PostgreSQL server: set --database")
    if not settings.estimator:
        end("--no-http without --estimator has nothing to do")
    import asyncio

    from service.composition.bootstrap import build_app

    context: ApiContext = build_app(settings, _opened(settings)).state.context

    async def run() -> None:
        stopped = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, stopped.set)
        await context.on_startup()
        typer.echo(json.dumps({"estimator": f"{socket.gethostname()}:{os.getpid()}"}))
        sys.stdout.flush()
        await stopped.wait()
        await context.on_shutdown()

    asyncio.run(run())


def _stop_when(is_due: Callable[[], bool], server: "StreamingServer", replaced: Event) -> None:
    """End a server when its archive was replaced."""
    while not server.should_exit:
        time.sleep(_POLL_S)
        if is_due():
            replaced.set()
            server.should_exit = True


def _opened(settings: "Settings") -> "Storage":
    """Return the archive; one behind a server is waited for, because both may have been started together."""
    from service.composition.bootstrap import build_storage

    until = time.monotonic() + _PATIENCE_S
    while True:
        try:
            return build_storage(settings)
        except (StorageError, ValueError) as error:
            is_away = isinstance(error, StorageError) and settings.database_url.startswith("postgresql")
            if not is_away or time.monotonic() > until:
                end(f"cannot use the database: {error}")
            _LOG.warning("the database does not answer, waiting for it: %s", error)
        time.sleep(_POLL_S)


def _server(settings: "Settings", app: "FastAPI", announced: socket.socket | None) -> "StreamingServer":
    """Return a server that says where it listens once it does, when it is given a socket to say it of."""
    from service.api.server_process import StreamingServer, server_config

    class AnnouncedServer(StreamingServer):
        """Says where it listens once it does."""

        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets)
            if self.started and announced is not None:
                name = f"[{settings.host}]" if ":" in settings.host else settings.host
                scheme = "https" if settings.tls_certificate else "http"
                address = f"{scheme}://{name}:{announced.getsockname()[1]}"
                typer.echo(json.dumps({"url": address, "api": f"{address}/api/v1"}))
                sys.stdout.flush()

    config = server_config(
        app,
        certificate=settings.tls_certificate,
        key=settings.tls_key,
        trusted_proxies=settings.trusted_proxies,
        request_timeout_s=settings.request_timeout_s,
    )
    return AnnouncedServer(config, app)
