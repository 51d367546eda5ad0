"""A line to an analyzer that does not answer the queries of one message in one line, on 127.0.0.1."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

#: answers on lines of their own; of several queries the last one alone is answered; SYST:ERR? answers a bare code
MODES = ("lines", "last only", "bare code")


class _Answers:
    """Answers of the analyzer, one at a time, blocks included."""

    def __init__(self, upstream: socket.socket) -> None:
        self._stream = upstream.makefile("rb")

    def take(self) -> bytes:
        """Return the next answer with its line feed; empty where the analyzer has left."""
        head = self._stream.read(2)
        if head[:1] != b"#" or not head[1:].isdigit() or head == b"#0":
            return head if head.endswith(b"\n") else head + self._stream.readline()
        digits = self._stream.read(int(head[1:]))
        return head + digits + self._stream.read(int(digits)) + self._stream.readline()


def _serve(client: socket.socket, port: int, mode: str) -> None:
    """Pass the messages of one client on."""
    with client, socket.create_connection(("127.0.0.1", port)) as upstream, client.makefile("rb") as messages:
        answers = _Answers(upstream)
        for message in messages:
            units = message.strip().split(b";")
            count = sum(b"?" in unit for unit in units)
            is_joined = count > 1 and mode != "bare code"
            taken = []
            for unit in units if is_joined else [message.strip()]:
                upstream.sendall(unit + b"\n")
                if b"?" in unit:
                    taken.append(answers.take())
            if taken:
                sent = taken if mode == "lines" else taken[-1:]
                code = b"".join(sent)
                client.sendall(code.replace(b'0,"No error"', b"0") if mode == "bare code" else code)


@contextmanager
def unjoined_line(port: int, mode: str) -> Iterator[int]:
    """Give the port of a line to the analyzer of a port that answers by one of `MODES`."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def accept() -> None:
            while True:
                try:
                    client, _ = listener.accept()
                except OSError:
                    return
                threading.Thread(target=_guarded, args=(client, port, mode), daemon=True).start()

        threading.Thread(target=accept, daemon=True).start()
        yield int(listener.getsockname()[1])
        listener.shutdown(socket.SHUT_RDWR)


def _guarded(client: socket.socket, port: int, mode: str) -> None:
    try:
        _serve(client, port, mode)
    except (OSError, ValueError):
        return  # one of both has left
