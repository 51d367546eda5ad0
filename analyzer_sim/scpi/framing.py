r"""Bytes of a stream -> program messages (IEEE 488.2, 7.1). No socket, no clock.

Law of this file: a message ends at a line feed that stands outside quotes and outside ``#<n><length>`` blocks; nothing
here knows a single command. A carriage return before the line feed belongs to the terminator, unless it is the last
byte of a block.

States of the framer, as a table::

    state     next byte of interest        new state
    PLAIN     LF                           PLAIN   (a message is complete)
    PLAIN     ' or "                       QUOTED
    PLAIN     # and a digit 1..9           BLOCK   (as many bytes as the header says)
    QUOTED    the same quote               PLAIN   (a doubled quote closes and opens again)
    BLOCK     count exhausted              PLAIN
    DISCARD   LF                           PLAIN   (an overrun is reported)

A message longer than the limit, or a block that announces more than the limit, moves to DISCARD: memory stays bounded
whatever arrives, and no announced length is ever waited for beyond the limit.
"""

import re
from enum import Enum, auto
from typing import NamedTuple

#: longest program message kept, bytes
MESSAGE_LIMIT_BYTES = 1 << 20

_SPECIAL = re.compile(rb"[\n'\"#]")


class FramerState(Enum):
    """State of the framer; the module docstring has the transitions."""

    PLAIN = auto()
    QUOTED = auto()
    BLOCK = auto()
    DISCARD = auto()


class ProgramMessage(NamedTuple):
    """One complete program message, without its terminator."""

    #: the bytes between two terminators; empty for an overrun
    body: bytes
    #: the message was longer than the limit and has been dropped
    is_overrun: bool


class MessageFramer:
    r"""Cut a byte stream into program messages.

    Parameters
    ----------
    limit_bytes : int
        Longest message kept; longer ones are dropped and reported.

    Examples
    --------
    >>> framer = MessageFramer()
    >>> [m.body for m in framer.feed(b"*IDN?\r\nDISP:TEXT 'a\nb'\nFR")]
    [b'*IDN?', b"DISP:TEXT 'a\nb'"]
    >>> framer.pending_bytes
    2
    """

    def __init__(self, limit_bytes: int = MESSAGE_LIMIT_BYTES) -> None:
        self._limit_bytes = limit_bytes
        self._buffer = bytearray()
        self._scan = 0
        self._block_end = 0
        self._quote = 0
        self._state = FramerState.PLAIN

    @property
    def state(self) -> FramerState:
        """State after the last byte fed."""
        return self._state

    @property
    def pending_bytes(self) -> int:
        """Bytes held of a message that is not complete."""
        return len(self._buffer)

    @property
    def missing(self) -> bytes:
        """Bytes that would end the pending quote or block; what a peer must send to be heard again."""
        if self._state is FramerState.QUOTED:
            return bytes([self._quote])
        if self._state is FramerState.BLOCK:
            return bytes(self._scan - len(self._buffer))
        return b""

    def feed(self, data: bytes) -> list[ProgramMessage]:
        """Take bytes, return the messages they complete, in order."""
        self._buffer += data
        messages: list[ProgramMessage] = []
        while (message := self._next_message()) is not None:
            messages.append(message)
        return messages

    def _next_message(self) -> ProgramMessage | None:
        """Scan to the next terminator; ``None`` when more bytes are needed."""
        while self._state is not FramerState.DISCARD:
            end = self._step()
            if end is None:
                if len(self._buffer) <= self._limit_bytes:
                    return None
                self._state = FramerState.DISCARD
            elif end >= 0:
                return self._cut(end)
        return self._discard()

    def _step(self) -> int | None:
        """Make one transition: position of a terminator, -1 after another transition, ``None`` = starved."""
        if self._state is FramerState.BLOCK:
            if len(self._buffer) < self._scan:
                return None
            self._block_end = self._scan
            self._state = FramerState.PLAIN
            return -1
        if self._state is FramerState.QUOTED:
            return self._leave_quote()
        found = _SPECIAL.search(self._buffer, self._scan)
        if found is None:
            self._scan = len(self._buffer)
            return None
        return self._enter(found.start())

    def _leave_quote(self) -> int | None:
        closing = self._buffer.find(self._quote, self._scan)
        if closing < 0:
            self._scan = len(self._buffer)
            return None
        self._scan = closing + 1
        self._state = FramerState.PLAIN
        return -1

    def _enter(self, at: int) -> int | None:
        """Act on a special byte met in PLAIN."""
        special = self._buffer[at]
        if special == ord("\n"):
            return at
        if special != ord("#"):
            self._quote = special
            self._state = FramerState.QUOTED
            self._scan = at + 1
            return -1
        return self._enter_block(at)

    def _enter_block(self, at: int) -> int | None:
        """Read ``#<n><length>``; anything else after # is ordinary text."""
        header = bytes(self._buffer[at + 1 : at + 11])
        if not header:
            self._scan = at
            return None
        digits = header[0] - ord("0")
        length = header[1 : 1 + digits] if 1 <= digits <= 9 else b""
        if not length.isdigit():
            if not length and 1 <= digits <= 9:
                self._scan = at
                return None
            self._scan = at + 1
            return -1
        if len(length) < digits:
            self._scan = at
            return None
        self._scan = at + 1 + 1 + digits + int(length)
        self._state = FramerState.DISCARD if int(length) > self._limit_bytes else FramerState.BLOCK
        return -1

    def _cut(self, end: int) -> ProgramMessage:
        """Take the message before position ``end`` out of the buffer."""
        body = bytes(self._buffer[:end])
        if self._block_end < end:
            body = body.removesuffix(b"\r")
        del self._buffer[: end + 1]
        self._scan = self._block_end = 0
        if end > self._limit_bytes:
            return ProgramMessage(b"", is_overrun=True)
        return ProgramMessage(body, is_overrun=False)

    def _discard(self) -> ProgramMessage | None:
        """Drop bytes up to the next line feed, then report the overrun once."""
        end = self._buffer.find(b"\n")
        if end < 0:
            self._buffer.clear()
            self._scan = self._block_end = 0
            return None
        del self._buffer[: end + 1]
        self._scan = self._block_end = 0
        self._state = FramerState.PLAIN
        return ProgramMessage(b"", is_overrun=True)
