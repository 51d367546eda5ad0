"""``soo demo inject``: a second terminal changes the world of the demonstration that runs."""

import json
import socket
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from service.cli.command_group import end
from service.cli.demonstration.running import RunningDemonstration, running_demonstration

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
    """Return what was changed, and what is to be seen."""
    carrier = f" ({answer['carrier']})" if answer.get("carrier") else ""
    span = f" from {answer['from']} until {answer['until']}" if "from" in answer else ""
    return f"{kind}{carrier}{span}: {_EXPECTED[kind]}"
