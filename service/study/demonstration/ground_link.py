"""Ground link: the simulator's second port, where the ground's knowledge comes as JSON lines in step with the rows."""

import json
import socket
from collections.abc import Iterator
from typing import Any, Self


class GroundLink:
    """Client of the ground port.

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

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._lines.close()
        self._socket.close()

    def messages(self) -> Iterator[dict[str, Any]]:
        """Yield the messages until the story ends or the simulator leaves."""
        for line in self._lines:
            message: dict[str, Any] = json.loads(line)
            yield message
            if message["kind"] == "end":
                return

    def proceed(self) -> None:
        """Confirm that all before the last hold was forwarded: the rows up to it may be swept."""
        self._socket.sendall(b'{"kind":"proceed"}\n')
