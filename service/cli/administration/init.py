"""``soo init``: a folder from which a service starts: settings, archive, first key, systemd unit.

Exit codes: 0 made, 2 the folder holds something already or cannot be written.
"""

import glob
import json
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from service.cli.command_group import end
from service.cli.operation.connection import JsonOption
from service.cli.operation.profile import ProfileError, write_profile
from service.records.storage import sqlite_url

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
    """Return the program of this installation."""
    program = Path(sys.executable).with_name("soo")
    return shlex.quote(str(program)) if program.exists() else f"{shlex.quote(sys.executable)} -m service"
