"""Craft line: the simulator's third port, where torque schedules go to the spacecraft and its reports come back."""

import json
import socket
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Self

from service.client.documents import Json

_AXES = ("yaw", "roll", "pitch")


class SpacecraftLineError(Exception):
    """The line to the spacecraft broke, or it refused a schedule; the text gives the reason."""


class SpacecraftReport(NamedTuple):
    """Telemetry report of the spacecraft on one command."""

    counter: int
    #: executed, executing, replaced, repeated, late or refused
    state: str
    reported: str
    #: of the executed elements; None = none
    executed_from: str | None
    executed_until: str | None
    #: N m s, of the executed elements
    impulse_n_m_s: dict[str, float]


class SpacecraftLine:
    """Client of the uplink port.

    Parameters
    ----------
    host, port : str, int
        Address of the port.
    timeout_s : float
        Longest wait for a line.
    """

    def __init__(self, host: str, port: int, timeout_s: float = 120.0) -> None:
        self._socket = socket.create_connection((host, port), timeout=timeout_s)
        self._lines = self._socket.makefile("rb")
        self._reports: list[SpacecraftReport] = []
        self._flown = ""
        try:
            #: torque that the loop on board feeds forward, as the catalogue states one; None = nothing was said of it
            self.fed_forward: Json | None = self._consume("start").get("fed_forward_torque")
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the line."""
        self._lines.close()
        self._socket.close()

    def send(self, schedule: Sequence[Mapping[str, Any]], counter: int) -> None:
        """Hand a schedule to the channel.

        Raises
        ------
        SpacecraftLineError
            It was refused.
        """
        line = json.dumps({"schedule": list(schedule), "counter": counter})
        self._socket.sendall(line.encode() + b"\n")
        self._consume("taken")

    def await_flown(self, epoch: str) -> list[SpacecraftReport]:
        """Wait until the spacecraft has come to the row of an epoch and return what it has told since the last call."""
        while self._flown < epoch:
            self._flown = self._consume("flown")["epoch"]
        reported, self._reports = self._reports, []
        return reported

    def _consume(self, wanted: str) -> Json:
        """Return the next line of a type; reports before it are kept."""
        while True:
            text = self._lines.readline()
            if not text:
                raise SpacecraftLineError("the spacecraft has closed its line")
            line: Json = json.loads(text)
            if line["type"] == "error":
                raise SpacecraftLineError(f"the spacecraft's line refused: {line['detail']}")
            if line["type"] == "report":
                self._reports.append(_report(line))
            if line["type"] == "flown":
                self._flown = line["epoch"]
            if line["type"] == wanted:
                return line


def _report(line: Json) -> SpacecraftReport:
    nothing = dict.fromkeys(_AXES, 0.0)
    return SpacecraftReport(
        line["counter"],
        line["state"],
        line["told"],
        line.get("executed_from"),
        line.get("executed_until"),
        line.get("impulse_n_m_s", nothing),
    )
