"""Messages, state and locks of HiSLIP sessions (IVI-6.1; VPP-4.3, 3.6). No socket, no waiting."""

import struct
from collections.abc import Hashable, Iterator
from enum import Enum, IntEnum, auto
from typing import NamedTuple

from analyzer_sim.scpi.framing import MESSAGE_LIMIT_BYTES, FramerState, MessageFramer, ProgramMessage

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


_M = MessageType
#: newest version spoken, major and minor byte
SERVER_VERSION = 0x0101
#: bit of the control code of Data, DataEnd, Trigger and AsyncStatusQuery: the last answer was delivered
_RMT_DELIVERED = 1
_REQUEST_BIT = 1 << 6
#: identifier of a client's first request, after Initialize and after a device clear
_FIRST_ID = 0xFFFFFF00
#: what a Trigger stands for
_TRIGGER = ProgramMessage(b"*TRG", is_overrun=False)


class Phase(Enum):
    """Phase of a session."""

    HALF_OPEN = auto()
    OPEN = auto()
    CLEARING = auto()
    CLOSED = auto()


#: messages of the synchronous channel; the others belong to the asynchronous one
SYNCHRONOUS = frozenset({_M.DATA, _M.DATA_END, _M.TRIGGER, _M.DEVICE_CLEAR_COMPLETE, _M.INITIALIZE})
_BOTH = frozenset({_M.ERROR, _M.FATAL_ERROR})

TRANSITIONS: dict[tuple[Phase, int], Phase] = {
    (Phase.HALF_OPEN, _M.ASYNC_INITIALIZE): Phase.OPEN,
    (Phase.OPEN, _M.DEVICE_CLEAR_COMPLETE): Phase.OPEN,
    (Phase.CLEARING, _M.DEVICE_CLEAR_COMPLETE): Phase.OPEN,
    **{(phase, _M.FATAL_ERROR): Phase.CLOSED for phase in Phase},
    **{(phase, _M.ASYNC_DEVICE_CLEAR): Phase.CLEARING for phase in (Phase.OPEN, Phase.CLEARING)},
    **{
        (phase, kind): phase
        for phase in (Phase.OPEN, Phase.CLEARING)
        for kind in (
            _M.DATA,
            _M.DATA_END,
            _M.TRIGGER,
            _M.ERROR,
            _M.ASYNC_MAX_MSG_SIZE,
            _M.ASYNC_LOCK,
            _M.ASYNC_LOCK_INFO,
            _M.ASYNC_STATUS_QUERY,
            _M.ASYNC_REMOTE_LOCAL_CONTROL,
        )
    },
}


class RefusedMessageError(Exception):
    """One message is refused; the session goes on."""

    def __init__(self, code: ErrorCode, text: str) -> None:
        super().__init__(text)
        self.code = code
        self.text = text


class Request(NamedTuple):
    """Request of a DataEnd or Trigger message."""

    message_id: int
    #: the client's program has the whole of the last answer
    is_delivered: bool
    programs: tuple[ProgramMessage, ...]


class HislipSession:
    """One session.

    Parameters
    ----------
    number : int
        Pairs the two channels, 16 bits.
    client_version : int
        Newest version the client speaks, major and minor byte.
    """

    def __init__(self, number: int, client_version: int) -> None:
        self.number = number
        self.version = min(client_version, SERVER_VERSION)
        self.phase = Phase.HALF_OPEN
        #: largest message the client takes, header included
        self.client_bytes = DEFAULT_CLIENT_BYTES
        #: an answer has been sent and the client has not said that it has it
        self.is_unread = False
        self._newest_id = _FIRST_ID - 2
        self._gathered = bytearray()
        self._is_spoilt = False
        self._is_overrun = False
        self._reasons = 0
        self._is_requesting = False

    def step(self, message: Message, *, is_synchronous: bool) -> None:
        """Move to the phase that follows a message.

        Raises
        ------
        FatalProtocolError, RefusedMessageError
            The message is not legal here.
        """
        following = TRANSITIONS.get((self.phase, message.kind))
        is_right_channel = message.kind in _BOTH or (message.kind in SYNCHRONOUS) == is_synchronous
        if following is None or not is_right_channel:
            raise _refusal(self.phase, message.kind)
        if message.is_oversize:
            self._is_spoilt = message.kind == _M.DATA
            self._gathered.clear()
            raise RefusedMessageError(ErrorCode.MESSAGE_TOO_LARGE, "the payload is larger than the size told")
        if message.kind == _M.ASYNC_DEVICE_CLEAR:
            self._forget()
        self.phase = following

    def _forget(self) -> None:
        """Empty input and output."""
        self._gathered.clear()
        self._is_spoilt = self._is_overrun = self.is_unread = False
        self._newest_id = _FIRST_ID - 2

    def gather(self, message: Message) -> Request | None:
        """Take a Data, DataEnd or Trigger; return the request it completes."""
        if self.phase is Phase.CLEARING:
            return None
        self._newest_id = message.parameter
        is_delivered = bool(message.control & _RMT_DELIVERED)
        if message.kind == _M.TRIGGER:
            return Request(message.parameter, is_delivered, (_TRIGGER,))
        if len(self._gathered) + len(message.payload) > MESSAGE_LIMIT_BYTES:
            self._is_overrun = True
            self._gathered.clear()
        elif not self._is_spoilt and not self._is_overrun:
            self._gathered += message.payload
        if message.kind == _M.DATA:
            return None
        data, is_spoilt, is_overrun = bytes(self._gathered), self._is_spoilt, self._is_overrun
        self._gathered.clear()
        self._is_spoilt = self._is_overrun = False
        if is_spoilt:
            return None
        overrun = (ProgramMessage(b"", is_overrun=True),)
        return Request(message.parameter, is_delivered, overrun if is_overrun else programs_of(data))

    def is_interrupted_by(self, request: Request) -> bool:
        """Tell whether a request leaves an answer unread; either way there is none any more."""
        is_interrupted = self.is_unread and not request.is_delivered
        self.is_unread = False
        return is_interrupted

    def on_delivery(self, message: Message) -> None:
        """Note what a status query says about the last answer."""
        if message.control & _RMT_DELIVERED:
            self.is_unread = False

    def is_service_wanted(self, status_byte: int, enable: int) -> bool:
        """Tell whether a reason to request service has come up since this was asked last."""
        reasons = status_byte & enable & ~_REQUEST_BIT
        is_new = bool(reasons & ~self._reasons)
        self._reasons = reasons
        self._is_requesting |= is_new
        return is_new

    def polled(self, status_byte: int) -> int:
        """Return the status byte as a serial poll does: bit 6 tells a request not yet polled, and is spent by it."""
        requesting = self._is_requesting << 6
        self._is_requesting = False
        return status_byte & ~_REQUEST_BIT | requesting

    def has_taken(self, message_id: int) -> bool:
        """Tell whether a request of this identifier, or a later one, has come; they count up and wrap around."""
        return ((self._newest_id - message_id) & 0xFFFFFFFF) < 0x80000000


def programs_of(data: bytes) -> tuple[ProgramMessage, ...]:
    r"""Return the program messages of one HiSLIP message: its end ends the last of them, whatever stands open.

    Examples
    --------
    >>> [message.body for message in programs_of(b"*CLS\n*IDN?")]
    [b'*CLS', b'*IDN?']
    """
    framer = MessageFramer()
    messages = framer.feed(data)
    if framer.state is FramerState.DISCARD:
        messages.append(ProgramMessage(b"", is_overrun=True))
    elif framer.pending_bytes:
        messages.append(ProgramMessage(data[-framer.pending_bytes :], is_overrun=False))
    return tuple(messages)


def _refusal(phase: Phase, kind: int) -> FatalProtocolError | RefusedMessageError:
    """Return what a message earns that has no row in the table."""
    if kind in {_M.INITIALIZE, _M.ASYNC_INITIALIZE}:
        return FatalProtocolError(FatalCode.INVALID_INITIALIZATION, "the channel is initialized already")
    if phase is Phase.HALF_OPEN:
        return FatalProtocolError(FatalCode.CHANNELS_INCOMPLETE, "the asynchronous channel is missing")
    if kind >= 128:
        return RefusedMessageError(ErrorCode.UNKNOWN_VENDOR_MESSAGE, "no vendor's messages are known")
    return RefusedMessageError(ErrorCode.UNKNOWN_TYPE, f"message type {kind} is unknown here")


class LockAnswer(IntEnum):
    """Control code of AsyncLockResponse."""

    #: no lock could be had in time
    FAILURE = 0
    #: a lock was granted, or an exclusive one released
    SUCCESS = 1
    #: a shared lock was released
    SUCCESS_SHARED = 2
    #: the client holds such a lock already, or none to release
    INVALID = 3


class LockTable:
    """Holders of the exclusive lock and of the shared lock; a client is any hashable object.

    Examples
    --------
    >>> table = LockTable()
    >>> table.request("a", ""), table.request("b", ""), table.may_run("b")
    (<LockAnswer.SUCCESS: 1>, None, False)
    """

    def __init__(self) -> None:
        self._exclusive: Hashable | None = None
        self._shared: set[Hashable] = set()
        self._key = ""

    @property
    def is_exclusive(self) -> bool:
        """Return whether an exclusive lock is held."""
        return self._exclusive is not None

    @property
    def holders(self) -> int:
        """Clients that hold a lock of either kind."""
        return len(self._shared | ({self._exclusive} if self.is_exclusive else set()))

    def may_run(self, client: Hashable) -> bool:
        """Tell whether a client's messages are executed now."""
        if self.is_exclusive:
            return self._exclusive == client
        return not self._shared or client in self._shared

    def request(self, client: Hashable, key: str) -> LockAnswer | None:
        """Ask for a lock, the exclusive one when the key is empty; ``None`` = it must be waited for."""
        if client == self._exclusive if not key else client in self._shared:
            return LockAnswer.INVALID
        if self.is_exclusive and self._exclusive != client:
            return None
        return self._share(client, key) if key else self._exclude(client)

    def _exclude(self, client: Hashable) -> LockAnswer | None:
        if self._shared and client not in self._shared:
            return None
        self._exclusive = client
        return LockAnswer.SUCCESS

    def _share(self, client: Hashable, key: str) -> LockAnswer | None:
        if self._shared and key != self._key:
            return None
        self._key = key
        self._shared.add(client)
        return LockAnswer.SUCCESS

    def release(self, client: Hashable) -> LockAnswer:
        """Give back the exclusive lock, or else the shared one."""
        if self.is_exclusive and self._exclusive == client:
            self._exclusive = None
            return LockAnswer.SUCCESS
        if client in self._shared:
            self._shared.discard(client)
            return LockAnswer.SUCCESS_SHARED
        return LockAnswer.INVALID

    def drop(self, client: Hashable) -> None:
        """Give back all a client holds: it has left."""
        if self._exclusive == client:
            self._exclusive = None
        self._shared.discard(client)
