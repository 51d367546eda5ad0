"""State of one HiSLIP session (IVI-6.1, synchronized mode): what is legal when, and what its messages add up to.

No socket, no clock, no SCPI. The session as a table; a message without a row is refused (see :func:`_refusal`)::

    phase      message                          next phase   what happens
    (none)     Initialize               sync    HALF_OPEN    session number given, version agreed, overlap declined
    HALF_OPEN  AsyncInitialize          async   OPEN         the two channels are one session
    OPEN       Data                     sync    OPEN         gathered
    OPEN       DataEnd, Trigger         sync    OPEN         a request: executed strictly in order
    OPEN       AsyncMaxMsgSize          async   OPEN         answers are cut to the client's size
    OPEN       AsyncLock, AsyncLockInfo async   OPEN         `lock_table.py`
    OPEN       AsyncStatusQuery         async   OPEN         status byte, bit 6 = service requested since last asked
    OPEN       AsyncRemoteLocalControl  async   OPEN         acknowledged
    OPEN       AsyncDeviceClear         async   CLEARING     execution ends, input and output are emptied
    CLEARING   Data, DataEnd, Trigger   sync    CLEARING     dropped: they were sent before the client knew
    CLEARING   DeviceClearComplete      sync    OPEN         acknowledged on the synchronous channel
    CLEARING   the other async ones     async   CLEARING     as in OPEN
    OPEN, CLEARING  Error               both    the same     nothing
    any        FatalError               both    CLOSED       both channels are closed

Interrupted (IVI-6.1, 3.1.1; IEEE 488.2, 6.3.2.3): a request that comes while an answer has not been delivered, as the
RMT-delivered bit of requests and status queries tells, clears the answer, queues -410 and is told on both channels.
"""

from enum import Enum, auto
from typing import NamedTuple

from analyzer_sim.lines.hislip_messages import (
    DEFAULT_CLIENT_BYTES,
    ErrorCode,
    FatalCode,
    FatalProtocolError,
    Message,
    MessageType,
)
from analyzer_sim.scpi.framing import MESSAGE_LIMIT_BYTES, FramerState, MessageFramer, ProgramMessage

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
