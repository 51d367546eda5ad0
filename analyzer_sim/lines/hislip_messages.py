"""Bytes of a HiSLIP channel <-> messages (IVI-6.1, 1.0 and 1.1). No socket, no state of a session.

Every message is a header of 16 bytes, big-endian, and a payload::

    "HS"   type   control code   message parameter   payload length   payload
    2      1      1              4                   8                length

Law of this file: what can be read is read (types and codes without a meaning come out as they are); the length on the
wire is a claim and never an allocation. A payload above the limit is skipped byte by byte and its message comes out
empty and marked; a length beyond all sense, or a wrong prologue, ends the channel.
"""

import struct
from collections.abc import Iterator
from enum import IntEnum
from typing import NamedTuple

HEADER = struct.Struct("!2sBBIQ")
_PROLOGUE = b"HS"
_SIZE = struct.Struct("!Q")

#: largest payload taken from a client, bytes; announced to it
MAX_PAYLOAD_BYTES = 1 << 20
#: what VISA lets a server assume until the client has told its own largest message, bytes
DEFAULT_CLIENT_BYTES = 1 << 20
#: a length above this is no length but garbage, bytes
_ABSURD_BYTES = 1 << 30
#: smallest part of an answer, whatever the client claims to be able to take, bytes
_LEAST_PART_BYTES = 16


class MessageType(IntEnum):
    """Numbers of table 4 of IVI-6.1 that versions 1.0 and 1.1 have."""

    INITIALIZE = 0
    INITIALIZE_RESPONSE = 1
    FATAL_ERROR = 2
    ERROR = 3
    ASYNC_LOCK = 4
    ASYNC_LOCK_RESPONSE = 5
    DATA = 6
    DATA_END = 7
    DEVICE_CLEAR_COMPLETE = 8
    DEVICE_CLEAR_ACKNOWLEDGE = 9
    ASYNC_REMOTE_LOCAL_CONTROL = 10
    ASYNC_REMOTE_LOCAL_RESPONSE = 11
    TRIGGER = 12
    INTERRUPTED = 13
    ASYNC_INTERRUPTED = 14
    ASYNC_MAX_MSG_SIZE = 15
    ASYNC_MAX_MSG_SIZE_RESPONSE = 16
    ASYNC_INITIALIZE = 17
    ASYNC_INITIALIZE_RESPONSE = 18
    ASYNC_DEVICE_CLEAR = 19
    ASYNC_SERVICE_REQUEST = 20
    ASYNC_STATUS_QUERY = 21
    ASYNC_STATUS_RESPONSE = 22
    ASYNC_DEVICE_CLEAR_ACKNOWLEDGE = 23
    ASYNC_LOCK_INFO = 24
    ASYNC_LOCK_INFO_RESPONSE = 25


class FatalCode(IntEnum):
    """Code of a fatal error, which ends the session."""

    UNIDENTIFIED = 0
    POORLY_FORMED_HEADER = 1
    CHANNELS_INCOMPLETE = 2
    INVALID_INITIALIZATION = 3
    TOO_MANY_CLIENTS = 4


class ErrorCode(IntEnum):
    """Code of an error that refuses one message; the session continues."""

    UNIDENTIFIED = 0
    UNKNOWN_TYPE = 1
    UNKNOWN_CONTROL_CODE = 2
    UNKNOWN_VENDOR_MESSAGE = 3
    MESSAGE_TOO_LARGE = 4


class FatalProtocolError(Exception):
    """The channel cannot go on; its code and text go to the client before it is closed."""

    def __init__(self, code: FatalCode, text: str) -> None:
        super().__init__(text)
        self.code = code
        self.text = text


class Message(NamedTuple):
    """One message as it came."""

    #: a number of :class:`MessageType`, or any other
    kind: int
    control: int
    parameter: int
    payload: bytes
    #: the payload was larger than the limit and has been dropped
    is_oversize: bool = False


def encode(kind: MessageType, control: int = 0, parameter: int = 0, payload: bytes = b"") -> bytes:
    """Return the bytes of one message.

    Examples
    --------
    >>> encode(MessageType.TRIGGER, 1, 0xFFFFFF00).hex(" ", 4)
    '48530c01 ffffff00 00000000 00000000'
    """
    return HEADER.pack(_PROLOGUE, kind, control, parameter, len(payload)) + payload


def encode_size(size_bytes: int) -> bytes:
    """Return the payload of the exchange of largest sizes."""
    return _SIZE.pack(size_bytes)


def decode_size(payload: bytes) -> int | None:
    """Return the size a client told, ``None`` when the payload is none."""
    return int(_SIZE.unpack(payload)[0]) if len(payload) == _SIZE.size else None


def answer_parts(answer: bytes, message_id: int, client_bytes: int) -> Iterator[bytes]:
    """Cut an answer into messages of at most ``client_bytes``, header included; the last one is DataEnd."""
    part = max(client_bytes - HEADER.size, _LEAST_PART_BYTES)
    last = max(0, (len(answer) - 1) // part * part)
    for start in range(0, last, part):
        yield encode(MessageType.DATA, 0, message_id, answer[start : start + part])
    yield encode(MessageType.DATA_END, 0, message_id, answer[last:])


class Decoder:
    """Cuts the bytes of one channel into messages.

    Parameters
    ----------
    limit_bytes : int
        Largest payload kept; it bounds the memory together with what is fed at once.

    Examples
    --------
    >>> decoder = Decoder()
    >>> [message.payload for message in decoder.feed(encode(MessageType.DATA_END, 0, 4, b"*IDN?"))]
    [b'*IDN?']
    """

    def __init__(self, limit_bytes: int = MAX_PAYLOAD_BYTES) -> None:
        self._limit_bytes = limit_bytes
        self._buffer = bytearray()
        self._header: Message | None = None
        self._missing = 0

    @property
    def pending_bytes(self) -> int:
        """Bytes held of a message that is not complete."""
        return len(self._buffer)

    def feed(self, data: bytes) -> Iterator[Message]:
        """Take bytes and give the messages they complete, in order.

        Raises
        ------
        FatalProtocolError
            A header is none; the messages before it have been given.
        """
        self._buffer += data
        while (message := self._next()) is not None:
            yield message

    def _next(self) -> Message | None:
        if self._header is None and not self._read_header():
            return None
        return self._read_payload()

    def _read_header(self) -> bool:
        """Read the next header; return whether there was one."""
        if not _PROLOGUE.startswith(self._buffer[:2]) and self._buffer[:2] != _PROLOGUE:
            raise FatalProtocolError(FatalCode.POORLY_FORMED_HEADER, "a message begins with HS")
        if len(self._buffer) < HEADER.size:
            return False
        _, kind, control, parameter, length = HEADER.unpack_from(self._buffer)
        if length > _ABSURD_BYTES:
            raise FatalProtocolError(FatalCode.POORLY_FORMED_HEADER, f"a payload of {length} bytes")
        del self._buffer[: HEADER.size]
        self._header = Message(kind, control, parameter, b"", is_oversize=length > self._limit_bytes)
        self._missing = length
        return True

    def _read_payload(self) -> Message | None:
        """Complete the message whose header has been read; ``None`` when bytes are missing."""
        header = self._header
        if header is None or (len(self._buffer) < self._missing and not header.is_oversize):
            return None
        payload = b"" if header.is_oversize else bytes(self._buffer[: self._missing])
        taken = min(self._missing, len(self._buffer))
        del self._buffer[:taken]
        self._missing -= taken
        if self._missing:
            return None
        self._header = None
        return header._replace(payload=payload)
