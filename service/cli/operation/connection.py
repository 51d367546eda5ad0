"""Connection of operators' commands to the service: address, key from the environment, and display of refusals."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.command_group import end

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient

ServiceUrl = Annotated[str, typer.Option(help="Address of the service.")]
KeyEnvironment = Annotated[str, typer.Option(help="Environment variable that holds the key.")]
SpacecraftOption = Annotated[str, typer.Option(help="Id of the spacecraft.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON only.")]

DEFAULT_SERVICE = "http://127.0.0.1:8000"
DEFAULT_KEY_ENVIRONMENT = "SOO_KEY"


def key_of(key_env: str) -> str:
    """Return the key of an environment variable, or of the file that the variable with ``_FILE`` names; else end."""
    path = os.environ.get(f"{key_env}_FILE")
    try:
        key = os.environ.get(key_env) or (Path(path).read_text(encoding="utf-8").strip() if path else "")
    except (OSError, UnicodeDecodeError) as error:
        end(f"no key: {key_env}_FILE names {path}, which cannot be read: {error}", cause=error)
    if not key:
        end(f"no key: the environment variable {key_env} is empty, and {key_env}_FILE names no file")
    return key


@contextmanager
def connected(service: str, key_env: str, **options: Any) -> Iterator["ServiceClient"]:
    """Give a client; a refusal of the service ends the command with its words and exit code 1."""
    key = key_of(key_env)
    # httpx costs more than the command line itself; a wrong option must not wait for it
    from service.client.problem import ClientError
    from service.client.service_client import ServiceClient

    try:
        with ServiceClient(service, key, **options) as client:
            yield client
    except ClientError as error:
        end(str(error), 1, error)
