"""Connection of operators' commands to the service: address, key, spacecraft, and display of refusals.

Options go before the environment (``SOO_URL``, ``SOO_KEY``, ``SOO_SPACECRAFT``), the environment before the profile. A
profile holds for its own service: its key is never sent to another one.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.command_group import end
from service.cli.operation.profile import ProfileError, UserProfile, profile_path, read_profile

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient

DEFAULT_SERVICE = "http://127.0.0.1:8000"
DEFAULT_KEY_ENVIRONMENT = "SOO_KEY"
OLDER = "it is older than this command; update the service, or use the soo of its version"


def _service_address(ctx: typer.Context, value: str) -> str:
    """Return the address that an option or the environment states, else that of the profile."""
    source = ctx.get_parameter_source("service")
    address = value if source is None or source.name != "DEFAULT" else _profile().service or value
    if not address.startswith(("http://", "https://")):
        end(f"{address!r} is no address of a service: state http://HOST:PORT or https://HOST:PORT")
    return address


def chosen_spacecraft(ctx: typer.Context, value: str) -> str:
    """Return the stated spacecraft, else that of the profile, else the only one of the service."""
    if value or ctx.resilient_parsing:
        return value
    service, key_env = ctx.params["service"], ctx.params["key_env"]
    stated = _profile_of(service).spacecraft
    if stated:
        return stated
    with connected(service, key_env) as client:
        found = [each["id"] for each in client.request("GET", "/spacecraft")["rows"]]
    if len(found) != 1:
        listed = f"has {', '.join(found)}: state one with --spacecraft" if found else "has no spacecraft: add one first"
        end(f"{service} {listed}")
    return str(found[0])


def _profile() -> UserProfile:
    """Return the user's profile; end the command where it cannot be used."""
    try:
        return read_profile()
    except ProfileError as error:
        end(str(error), cause=error)


def _profile_of(service: str) -> UserProfile:
    """Return the user's profile, an empty one where it is for another service."""
    profile = _profile()
    own = (profile.service or DEFAULT_SERVICE).rstrip("/")
    return profile if own == service.rstrip("/") else UserProfile()


# the spacecraft is chosen by these two, so they are read before it
ServiceUrl = Annotated[
    str, typer.Option(help="Address of the service.", envvar="SOO_URL", is_eager=True, callback=_service_address)
]
KeyEnvironment = Annotated[str, typer.Option(help="Environment variable that holds the key.", is_eager=True)]
SpacecraftOption = Annotated[
    str,
    typer.Option(
        help="Id of the spacecraft.",
        envvar="SOO_SPACECRAFT",
        default_factory=str,
        show_default="that of the profile, or the only one",
        callback=chosen_spacecraft,
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON only.")]


def key_of(key_env: str, service: str | None = None) -> str:
    """Return the key of an environment variable, or of the file that the variable with ``_FILE`` names; else end.

    With a service, and with the default variable, the key file of the service's profile follows.
    """
    path = os.environ.get(f"{key_env}_FILE")
    try:
        key = os.environ.get(key_env) or (Path(path).read_text(encoding="utf-8").strip() if path else "")
    except (OSError, UnicodeDecodeError) as error:
        end(f"no key: {key_env}_FILE names {path}, which cannot be read: {error}", cause=error)
    if not key and service is not None and key_env == DEFAULT_KEY_ENVIRONMENT:
        try:
            key = _profile_of(service).key() or ""
        except ProfileError as error:
            end(f"no key: {error}", cause=error)
    if not key:
        end(
            f"no key: the environment variable {key_env} is empty, {key_env}_FILE names no file, "
            f"and {profile_path()} names none for this service"
        )
    return key


def stored_key(key_env: str) -> str | None:
    """Return the key of the file that the variable with ``_FILE`` names, as it is now; None where there is none."""
    path = os.environ.get(f"{key_env}_FILE")
    if os.environ.get(key_env) or not path:
        return None
    try:
        return Path(path).read_text(encoding="utf-8").strip() or None
    except (OSError, UnicodeDecodeError):
        return None


@contextmanager
def connected(service: str, key_env: str, **options: Any) -> Iterator["ServiceClient"]:
    """Give a client; a refusal of the service ends the command with its words and exit code 1."""
    key = key_of(key_env, service)
    # httpx costs more than the command line itself; a wrong option must not wait for it
    from service.client.problem import ClientError
    from service.client.service_client import ServiceClient

    try:
        with ServiceClient(service, key, **options) as client:
            yield client
    except ClientError as error:
        end(_refusal(error, getattr(error, "code", ""), key_env), 1, error)


def on_service(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command a client as its first argument, and the options that say of which service and by which key."""
    _client, *own = signature(command).parameters.values()
    as_json = [each for each in own if each.name == "as_json"]
    kind = Parameter.POSITIONAL_OR_KEYWORD
    parameters = [
        *own[: len(own) - len(as_json)],
        Parameter("service", kind, default=DEFAULT_SERVICE, annotation=ServiceUrl),
        Parameter("key_env", kind, default=DEFAULT_KEY_ENVIRONMENT, annotation=KeyEnvironment),
        *as_json,
    ]

    @wraps(command)
    def command_on_service(service: str, key_env: str, **options: Any) -> None:
        with connected(service, key_env) as client:
            command(client, **options)

    # Typer makes the options of a command from these two
    vars(command_on_service)["__signature__"] = Signature(parameters)
    command_on_service.__annotations__ = {each.name: each.annotation for each in parameters}
    return command_on_service


def _refusal(error: Exception, code: str, key_env: str) -> str:
    """Return the words of a refusal; the service knows neither that it is older nor where this machine has its key."""
    said = str(error).partition("\nNext: ")[0]
    if code in {"path.unknown", "method.not_allowed"}:
        return f"{said}\nthe service does not know this request: {OLDER}"
    if code == "key.invalid":
        return f"{said}\nNext: correct the key of {key_env}, of the file of {key_env}_FILE, or of {profile_path()}"
    return str(error)
