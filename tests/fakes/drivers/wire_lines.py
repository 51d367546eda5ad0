"""Lines to a live instrument, byte by byte: a raw socket and a HiSLIP session, written from IVI-6.1 alone."""

import socket
import struct
from typing import NamedTuple

TIMEOUT_S = 120.0
_HEADER = struct.Struct("!2sBBIQ")
(
    *_,
    DATA,
    DATA_END,
    CLEAR_COMPLETE,
    CLEAR_ACKNOWLEDGE,
    REMOTE_LOCAL,
    REMOTE_LOCAL_RESPONSE,
    TRIGGER,
    INTERRUPTED,
    ASYNC_INTERRUPTED,
    MAX_SIZE,
    MAX_SIZE_RESPONSE,
    ASYNC_INITIALIZE,
    ASYNC_INITIALIZE_RESPONSE,
    ASYNC_CLEAR,
    SERVICE_REQUEST,
    STATUS_QUERY,
    STATUS_RESPONSE,
    ASYNC_CLEAR_ACKNOWLEDGE,
    LOCK_INFO,
    LOCK_INFO_RESPONSE,
) = range(26)


class Packet(NamedTuple):
    """One HiSLIP message."""

    kind: int
    control: int
    parameter: int
    payload: bytes


def connected(port: int) -> socket.socket:
    """Return a connection without delays."""
    line = socket.create_connection(("127.0.0.1", port), timeout=TIMEOUT_S)
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return line


def received(line: socket.socket, count: int) -> bytes:
    """Return exactly so many bytes."""
    data = b""
    while len(data) < count:
        chunk = line.recv(count - len(data))
        if not chunk:
            raise ConnectionError("the instrument closed the line")
        data += chunk
    return data


class RawLine:
    """A raw socket."""

    def __init__(self, port: int) -> None:
        self.socket = connected(port)

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self.socket.sendall(data)

    def read_until(self, tail: bytes) -> bytes:
        """Return what comes until it ends with something."""
        data = b""
        while not data.endswith(tail):
            chunk = self.socket.recv(1 << 16)
            if not chunk:
                raise ConnectionError("the instrument closed the line")
            data += chunk
        return data

    def ask(self, text: str) -> str:
        """Send one message and return the line that answers."""
        self.write(text.encode() + b"\n")
        return self.read_until(b"\n").decode().removesuffix("\n")

    def close(self) -> None:
        """Close the line."""
        self.socket.close()


class HislipLine:
    """A HiSLIP session in synchronized mode."""

    def __init__(self, port: int, client_bytes: int = 1 << 20) -> None:
        self.synchronous = connected(port)
        self.put(0, 0, 0x0101 << 16 | int.from_bytes(b"JU", "big"), b"hislip0")
        opened = self.consume()
        self.is_overlap_preferred = bool(opened.control & 1)
        self.number = opened.parameter & 0xFFFF
        self.asynchronous = connected(port)
        self.put_asynchronous(ASYNC_INITIALIZE, 0, self.number)
        self.on_asynchronous(ASYNC_INITIALIZE_RESPONSE)
        self.put_asynchronous(MAX_SIZE, 0, 0, struct.pack("!Q", client_bytes))
        self.server_bytes = struct.unpack("!Q", self.on_asynchronous(MAX_SIZE_RESPONSE).payload)[0]
        self.message_id = 0xFFFFFF00
        self.is_delivered = False

    def put(self, kind: int, control: int = 0, parameter: int = 0, payload: bytes = b"") -> None:
        """Send a message on the synchronous channel."""
        self.synchronous.sendall(_HEADER.pack(b"HS", kind, control, parameter, len(payload)) + payload)

    def put_asynchronous(self, kind: int, control: int = 0, parameter: int = 0, payload: bytes = b"") -> None:
        """Send a message on the asynchronous channel."""
        self.asynchronous.sendall(_HEADER.pack(b"HS", kind, control, parameter, len(payload)) + payload)

    @staticmethod
    def _packet(line: socket.socket) -> Packet:
        prologue, kind, control, parameter, length = _HEADER.unpack(received(line, _HEADER.size))
        assert prologue == b"HS"
        return Packet(kind, control, parameter, received(line, length))

    def consume(self) -> Packet:
        """Return the next message of the synchronous channel."""
        return self._packet(self.synchronous)

    def on_asynchronous(self, kind: int | None = None) -> Packet:
        """Return the next message of the asynchronous channel; with a kind, the next of that kind."""
        while True:
            packet = self._packet(self.asynchronous)
            if kind is None or packet.kind == kind:
                return packet

    def write(self, data: bytes) -> int:
        """Send one program message as DataEnd; return its identifier."""
        sent = self.message_id
        self.put(DATA_END, int(self.is_delivered), sent, data)
        self.is_delivered = False
        self.message_id = (sent + 2) & 0xFFFFFFFF
        return sent

    def read(self) -> tuple[int, bytes]:
        """Return identifier and bytes of one answer; what is neither Data nor DataEnd is passed over."""
        answer = b""
        while True:
            packet = self.consume()
            if packet.kind in {DATA, DATA_END}:
                answer += packet.payload
            if packet.kind == DATA_END:
                self.is_delivered = True
                return packet.parameter, answer

    def ask(self, text: str) -> str:
        """Send one message and return the line that answers."""
        self.write(text.encode() + b"\n")
        return self.read()[1].decode().removesuffix("\n")

    def status(self) -> int:
        """Return the status byte as a serial poll does."""
        self.put_asynchronous(STATUS_QUERY, int(self.is_delivered), (self.message_id - 2) & 0xFFFFFFFF)
        self.is_delivered = False
        return self.on_asynchronous(STATUS_RESPONSE).control

    def clear(self) -> None:
        """Clear the device: both channels, then start again."""
        self.put_asynchronous(ASYNC_CLEAR)
        self.on_asynchronous(ASYNC_CLEAR_ACKNOWLEDGE)
        self.put(CLEAR_COMPLETE)
        while self.consume().kind != CLEAR_ACKNOWLEDGE:
            pass
        self.message_id = 0xFFFFFF00
        self.is_delivered = False

    def close(self) -> None:
        """Close both channels."""
        self.synchronous.close()
        self.asynchronous.close()
