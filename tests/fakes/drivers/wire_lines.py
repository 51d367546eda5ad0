"""Lines to a live instrument, byte by byte: a raw socket and a HiSLIP session, written from IVI-6.1 alone.

They share no code with the simulator: what both got wrong alike would not be seen.
"""

import socket
import struct
from typing import NamedTuple, Self

TIMEOUT_S = 120.0
FIRST_ID = 0xFFFFFF00
_HEADER = struct.Struct("!2sBBIQ")
# numbers of table 4 of IVI-6.1
INITIALIZE, INITIALIZED, FATAL, ERROR, LOCK, LOCKED, DATA, DATA_END, CLEAR_COMPLETE, CLEAR_DONE = range(10)
REMOTE, REMOTE_DONE, TRIGGER, INTERRUPTED, ASYNC_INTERRUPTED, SIZE, SIZE_TOLD, ASYNC_INITIALIZE = range(10, 18)
ASYNC_INITIALIZED, CLEAR, SERVICE, STATUS, STATUS_TOLD, CLEAR_ACKNOWLEDGED, LOCK_INFO, LOCK_TOLD = range(18, 26)


class Heard(NamedTuple):
    """One HiSLIP message."""

    kind: int
    control: int
    parameter: int
    payload: bytes


class RawLine:
    """A raw socket."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=TIMEOUT_S)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self.socket.sendall(data)

    def received(self, count: int) -> bytes:
        """Return exactly so many bytes."""
        data = b""
        while len(data) < count:
            data += self._chunk(count - len(data))
        return data

    def read_until(self, tail: bytes) -> bytes:
        """Return what comes until it ends with something."""
        data = b""
        while not data.endswith(tail):
            data += self._chunk(1 << 16)
        return data

    def _chunk(self, limit: int) -> bytes:
        chunk = self.socket.recv(limit)
        if not chunk:
            raise ConnectionError("the instrument closed the line")
        return chunk

    def ask(self, text: str) -> str:
        """Send one message and return the line that answers."""
        self.write(text.encode() + b"\n")
        return self.read_until(b"\n").decode().removesuffix("\n")

    def hears_nothing(self, for_s: float = 0.2) -> bool:
        """Tell whether nothing comes for some time."""
        self.socket.settimeout(for_s)
        try:
            return self.socket.recv(1) == b"never"
        except TimeoutError:
            return True
        finally:
            self.socket.settimeout(TIMEOUT_S)

    def is_closed(self) -> bool:
        """Tell whether the instrument has closed the line."""
        try:
            return self.socket.recv(1) == b""
        except ConnectionResetError:
            return True

    def close(self) -> None:
        """Close the line."""
        self.socket.close()


class Channel(RawLine):
    """One connection of HiSLIP messages."""

    def say(self, kind: int, control: int = 0, parameter: int = 0, payload: bytes = b"") -> None:
        """Send a message."""
        self.write(_HEADER.pack(b"HS", kind, control, parameter, len(payload)) + payload)

    def on_input(self) -> Heard:
        """Return the next message."""
        prologue, kind, control, parameter, length = _HEADER.unpack(self.received(_HEADER.size))
        assert prologue == b"HS"
        return Heard(kind, control, parameter, self.received(length))


class HislipLine:
    """A session in synchronized mode: numbers its messages and tells what it has read, as IVI-6.1 wants it."""

    def __init__(self, port: int, version: int = 0x0100) -> None:
        self.sync, self.side = Channel(port), Channel(port)
        self.sync.say(INITIALIZE, 0, version << 16 | 0x7878, b"hislip0")
        self.opened = self.sync.on_input()
        assert self.opened.kind == INITIALIZED
        self.side.say(ASYNC_INITIALIZE, 0, self.opened.parameter & 0xFFFF)
        assert self.side.on_input()[:2] == (ASYNC_INITIALIZED, 0)
        self.next_id, self.last_id, self.delivered = FIRST_ID, FIRST_ID - 2, 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, data: bytes, kind: int = DATA_END) -> int:
        """Send one program message; return its identifier."""
        self.sync.say(kind, self.delivered, self.next_id, data)
        self.delivered, self.last_id = 0, self.next_id
        self.next_id = (self.next_id + 2) & 0xFFFFFFFF
        return self.last_id

    def read(self) -> bytes:
        """Return the answer to the last message."""
        answer = b""
        while True:
            heard = self.sync.on_input()
            assert heard.kind in {DATA, DATA_END}, heard
            assert heard.parameter == self.last_id
            answer += heard.payload
            if heard.kind == DATA_END:
                self.delivered = 1
                return answer

    def ask(self, text: str) -> str:
        """Send one message and return the line that answers."""
        self.write(text.encode())
        return self.read().decode().removesuffix("\n")

    def status(self) -> int:
        """Return the status byte as a serial poll does."""
        self.side.say(STATUS, self.delivered, self.last_id)
        heard = self.side.on_input()
        assert heard.kind == STATUS_TOLD, heard
        self.delivered = 0
        return heard.control

    def lock(self, timeout_ms: int = 0, key: bytes = b"") -> int:
        """Ask for the lock; return the answer."""
        self.side.say(LOCK, 1, timeout_ms, key)
        return self.lock_answer()

    def unlock(self) -> int:
        """Give the lock back; return the answer."""
        self.side.say(LOCK, 0, self.last_id)
        return self.lock_answer()

    def lock_answer(self) -> int:
        """Return the answer to a request for the lock."""
        heard = self.side.on_input()
        assert heard.kind == LOCKED, heard
        return heard.control

    def clear(self) -> None:
        """Clear the device: both channels, then start again; requests for service that stand are passed over."""
        self.side.say(CLEAR)
        while self.side.on_input().kind != CLEAR_ACKNOWLEDGED:
            pass
        self.sync.say(CLEAR_COMPLETE)
        while self.sync.on_input().kind != CLEAR_DONE:
            pass
        self.next_id, self.last_id, self.delivered = FIRST_ID, FIRST_ID - 2, 0

    def close(self) -> None:
        """Close both channels."""
        self.sync.close()
        self.side.close()
