"""``soo demo``: simulated analyzer, front end and service on this machine, from nothing to angles beside the truth."""

import json
import os
import signal
import socket
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import typer

from service.cli.command_group import end, new_app, require, state_folder
from service.cli.studies import ended_by_signals


class RunningDemonstration(NamedTuple):
    """Addresses of a demonstration."""

    process_id: int
    service_url: str
    key_file: str
    #: host and port where its world is changed; None = its spacecraft is not flown
    changes: tuple[str, int] | None


def _path() -> Path:
    """Return the file: in the user's runtime folder, which ends with the session, else in that of states."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(runtime) / "soo" if runtime else state_folder("demonstration")
    return folder / "demonstration.json"


@contextmanager
def published(demonstration: RunningDemonstration) -> Iterator[None]:
    """Let other commands find a demonstration while it runs; the newest of several is found."""
    path = _path()
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    new = path.with_suffix(f".{demonstration.process_id}")
    new.unlink(missing_ok=True)
    new.touch(0o600, exist_ok=False)
    new.write_text(json.dumps(demonstration._asdict()), encoding="utf-8")
    new.replace(path)
    try:
        yield
    finally:
        newest = _read(path)
        if newest is not None and newest.process_id == demonstration.process_id:
            path.unlink(missing_ok=True)


def running_demonstration() -> RunningDemonstration:
    """Return the demonstration that runs; without one end with exit code 1."""
    found = _read(_path())
    if found is None or not _is_alive(found.process_id):
        end("no demonstration of this user runs: start one with soo demo and wait until it is aligned", 1)
    return found


def _read(path: Path) -> RunningDemonstration | None:
    """Return what a file holds; None for no file, or one that holds something else."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        changes = document["changes"]
        address = None if changes is None else (str(changes[0]), int(changes[1]))
        return RunningDemonstration(
            int(document["process_id"]), str(document["service_url"]), str(document["key_file"]), address
        )
    except (OSError, ValueError, TypeError, KeyError, IndexError):
        return None


def _is_alive(process_id: int) -> bool:
    """Return whether a process of this user runs under a number."""
    try:
        os.kill(process_id, 0)
    except OSError:
        return False
    return True


_TIMEOUT_S = 60.0
#: what the service is to say, and what the change is
_EXPECTED = {
    "rain": "rain over the receiving site: control is inhibited by a fade until ten minutes after its end",
    "step": "one carrier is 3 dB stronger: it is left out of the estimate",
    "dead-carrier": "one carrier is off: it is left out of the estimate",
    "sign": "the wheels do the opposite of each command: the powers show it and control ends, mostly within the hour",
    "stop": "an operator stopped control: it is tripped until somebody resets it",
}
Kind = Literal["rain", "step", "dead-carrier", "sign", "stop"]


def inject(
    kind: Annotated[Kind, typer.Argument(help="What happens.")],
    minutes: Annotated[float, typer.Option(help="How long, minutes of the virtual clock; stop has no end.")] = 120.0,
    carrier: Annotated[str, typer.Option(help="Carrier of step and dead-carrier; default the first.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON only.")] = False,
) -> None:
    """Change the world of the demonstration that runs, for a time."""
    if carrier and kind not in {"step", "dead-carrier"}:
        end(f"{kind} concerns no single carrier: leave --carrier out")
    demonstration = running_demonstration()
    try:
        answer = _stop(demonstration) if kind == "stop" else _change(demonstration, kind, minutes, carrier)
    except OSError as error:
        end(f"the demonstration does not answer: {error}; see whether it still runs", 1, error)
    typer.echo(json.dumps(answer) if as_json else _sentence(kind, answer))


def _change(demonstration: RunningDemonstration, kind: str, minutes: float, carrier: str) -> dict[str, Any]:
    """Have the simulator change the world and return its answer."""
    if demonstration.changes is None:
        end("the spacecraft of this demonstration is not flown: start soo demo without --open", 1)
    line = {"change": kind, "duration_s": 60.0 * minutes, **({"carrier": carrier} if carrier else {})}
    with (
        socket.create_connection(demonstration.changes, timeout=_TIMEOUT_S) as connection,
        connection.makefile("rb") as answers,
    ):
        connection.sendall(json.dumps(line).encode() + b"\n")
        text = answers.readline()
    if not text:
        raise ConnectionResetError("the simulator closed the connection")
    answer: dict[str, Any] = json.loads(text)
    if answer["type"] == "error":
        end(f"nothing was changed: {answer['detail']}")
    return answer


def _stop(demonstration: RunningDemonstration) -> dict[str, Any]:
    """Stop control as an operator does and return the state after it."""
    # httpx costs more than the other kinds
    from service.client.problem import ClientError
    from service.client.service_client import ServiceClient

    key = Path(demonstration.key_file).read_text(encoding="ascii").strip()
    try:
        with ServiceClient(demonstration.service_url, key, timeout_s=_TIMEOUT_S) as client:
            rows = client.request("GET", "/spacecraft")["rows"]
            if not rows:
                end("the demonstration has no spacecraft yet: wait until it is aligned", 1)
            control = client.order_control(rows[0]["id"], "stop", "stopped by soo demo inject")
    except ClientError as error:
        end(str(error), 1, error)
    return {"type": "stopped", "state": control["state"]}


def _sentence(kind: str, answer: dict[str, Any]) -> str:
    carrier = f" ({answer['carrier']})" if answer.get("carrier") else ""
    span = f" from {answer['from']} until {answer['until']}" if "from" in answer else ""
    return f"{kind}{carrier}{span}: {_EXPECTED[kind]}"


#: operation that the endless demonstration can show, days
_ENDLESS_DAYS = 30.0
_EXIT_DAYS = 2.0
ReleaseMode = Literal["automatic", "two_step"]


demo_app = new_app(invoke_without_command=True, context_settings={"allow_interspersed_args": False})


@demo_app.callback()
def demo(
    context: typer.Context,
    leave: Annotated[bool, typer.Option("--exit", help="Stop after two virtual days and print figures.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print figures as JSON only.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of the simulated world.")] = 1,
    days: Annotated[float | None, typer.Option(help="Virtual days of operation.")] = None,
    quiet_days: Annotated[float | None, typer.Option(help="Virtual quiet days before the turns.")] = None,
    figure: Annotated[Path | None, typer.Option(help="Draw estimate and truth into this PNG file at the end.")] = None,
    keep: Annotated[Path | None, typer.Option(help="Keep database and logs in this folder.", file_okay=False)] = None,
    release: Annotated[
        ReleaseMode, typer.Option(help="automatic, or two_step: two persons release each command, their keys printed.")
    ] = "automatic",
    rows_per_second: Annotated[
        float, typer.Option(help="Pace of tracking under release automatic; 0 = as fast as it goes.")
    ] = 20.0,
    service: Annotated[str | None, typer.Option(help="Use a service that runs already (key in SOO_KEY).")] = None,
    analyzer: Annotated[str | None, typer.Option(help="HOST:PORT of a simulated analyzer that runs already.")] = None,
    ground: Annotated[str | None, typer.Option(help="HOST:PORT of its ground port.")] = None,
    uplink: Annotated[str | None, typer.Option(help="HOST:PORT of its uplink, when its spacecraft is flown.")] = None,
    closed: Annotated[bool, typer.Option("--closed/--open", help="Keep the spacecraft, or follow its slews.")] = True,
) -> None:
    """Show the whole chain: SCPI analyzer to angles to torques that keep the spacecraft, on a virtual clock."""
    if context.invoked_subcommand is not None:
        return
    from rich.console import Console

    # its front end measures by it, in a process of its own
    require("pyvisa")
    # the story costs half a second that a wrong option need not pay
    from service.cli.demonstration.demo_run import FAILURES, Alone, external, own_station, play
    from service.cli.demonstration.demo_screen import Presenter, print_figures
    from service.cli.demonstration.persons import offer_archive, write_key

    is_two_step = release == "two_step"
    if is_two_step and (leave or as_json or not closed or service):
        end("--release two_step waits for persons at the console: leave out --exit, --json, --open and --service")
    console = Console(stderr=as_json)
    operation_days = days or (_EXIT_DAYS if leave else _ENDLESS_DAYS)
    story = Alone(seed, operation_days, quiet_days)
    pace = 0.0 if leave or is_two_step else rows_per_second
    presenter = Presenter(console, pace, with_table=not leave and not as_json)
    with ExitStack() as stack:
        stack.enter_context(ended_by_signals())
        directory = _directory(stack, keep)
        try:
            with ExitStack() as station:
                station.callback(presenter.close)
                presenter.open()
                if service and analyzer and ground:
                    endpoints = external(service, analyzer, ground, uplink)
                else:
                    endpoints = station.enter_context(own_station(directory, story, release if closed else None))
                    write_key(directory / "administrator.key", endpoints.key)
                    presenter.announce(endpoints.service_url, directory / "administrator.key")
                    key_file = str((directory / "administrator.key").resolve())
                    found = RunningDemonstration(os.getpid(), endpoints.service_url, key_file, endpoints.changes)
                    station.enter_context(published(found))
                figures = play(directory, endpoints, presenter, figure, story, is_two_step=is_two_step)
        except KeyboardInterrupt as interruption:
            console.print("stopped")
            if not service:
                offer_archive(console, directory, keep, is_asked=interruption.args == (signal.SIGINT,))
            return
        except FAILURES as error:
            end(f"the demonstration failed: {error}", cause=error)
    typer.echo(json.dumps({"seed": seed, **figures}, allow_nan=False)) if as_json else print_figures(console, figures)
    if figures["missed"]:
        raise typer.Exit(1)


demo_app.command()(inject)


def _directory(stack: ExitStack, keep: Path | None) -> Path:
    """Return the folder of database and logs; it goes with the demonstration unless it is to be kept."""
    if keep is None:
        return Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="soo-demo-")))
    if (keep / "soo.db").exists():
        end(f"{keep} holds the database of an earlier demonstration; name another folder")
    keep.mkdir(parents=True, exist_ok=True)
    return keep
