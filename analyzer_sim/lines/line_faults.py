"""Faults of the line between instrument and client, armed from a test, each spent by one answer."""

import asyncio
import socket
import struct
import threading
from collections import deque
from collections.abc import Iterable
from enum import Enum

#: how much later a LATE answer comes unless told otherwise, s
LATE_BY_S = 2.0


class LineFault(Enum):
    """Faults in the transmission of one answer."""

    #: the connection is reset instead of an answer
    RESET = "reset"
    #: the connection is closed in good order instead of an answer
    CLOSE = "close"
    #: nothing is sent, the connection stays
    SILENT = "silent"
    #: bytes that are no answer are sent
    GARBAGE = "garbage"
    #: half of a block is sent, then the connection is reset
    RESET_IN_BLOCK = "reset_in_block"
    #: half of a block is sent, then nothing more
    HALF_BLOCK = "half_block"
    #: the answer is withheld and sent right before the next one of its session
    STALE = "stale"
    #: the answer comes `LineFaults.late_by_s` later, those after it wait behind it
    LATE = "late"


_NEED_BLOCK = frozenset({LineFault.RESET_IN_BLOCK, LineFault.HALF_BLOCK})

#: what GARBAGE sends: bytes outside ASCII, a block header without digits, one line feed at the end
GARBAGE_BYTES = b"\xff\xfe#x;;\x00\x80" * 8 + b"\n"


class LineFaults:
    """Faults to come, in order; may be armed from any thread.

    Attributes
    ----------
    is_silent_peer : bool
        While it is set connections are accepted, messages are executed and no answer is ever sent.
    late_by_s : float
        How much later a LATE answer comes, s.

    Examples
    --------
    >>> faults = LineFaults()
    >>> faults.arm(LineFault.SILENT)
    >>> faults.consume(b"1"), faults.consume(b"1")
    (<LineFault.SILENT: 'silent'>, None)
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._armed: deque[LineFault] = deque()
        self.is_silent_peer = False
        self.late_by_s = LATE_BY_S

    def arm(self, fault: LineFault, times: int = 1) -> None:
        """Let the next answers suffer this fault."""
        with self._lock:
            self._armed.extend([fault] * times)

    def disarm(self) -> None:
        """Forget all faults to come; the peer speaks again."""
        with self._lock:
            self._armed.clear()
            self.is_silent_peer = False

    @property
    def remaining(self) -> int:
        """Faults armed and not yet spent."""
        with self._lock:
            return len(self._armed)

    def consume(self, answer: bytes) -> LineFault | None:
        """Spend the next fault on this answer, if it applies to it."""
        if self.is_silent_peer:
            return LineFault.SILENT
        with self._lock:
            if not self._armed or (self._armed[0] in _NEED_BLOCK and not answer.startswith(b"#")):
                return None
            return self._armed.popleft()


_ENDS_LINE = frozenset({LineFault.RESET, LineFault.RESET_IN_BLOCK, LineFault.CLOSE})
_RESETS = frozenset({LineFault.RESET, LineFault.RESET_IN_BLOCK})
_HALVES = frozenset({LineFault.RESET_IN_BLOCK, LineFault.HALF_BLOCK})


class LineEndedError(Exception):
    """A fault has ended the connection."""


class FaultyLine:
    """The sending side of one connection.

    Parameters
    ----------
    writer : asyncio.StreamWriter
        The connection.
    faults : LineFaults
        What is to go wrong.
    """

    def __init__(self, writer: asyncio.StreamWriter, faults: LineFaults) -> None:
        self._writer = writer
        self._faults = faults
        self._withheld = b""
        line: socket.socket = writer.get_extra_info("socket")
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # with no high-water mark `drain` returns when the operating system has every byte: an answer counts as handed
        # out only then
        writer.transport.set_write_buffer_limits(high=0)

    async def send(self, answer: bytes, parts: Iterable[bytes]) -> bool:
        """Send an answer as the bytes ``parts``; return whether it left whole and in time.

        Raises
        ------
        LineEndedError
            A fault has ended the connection.
        """
        fault = self._faults.consume(answer)
        if fault is None:
            await self._write([self._withheld, *parts] if self._withheld else parts)
            self._withheld = b""
            return True
        await self._suffer(fault, b"".join(parts))
        return False

    async def _suffer(self, fault: LineFault, wire: bytes) -> None:
        if fault is LineFault.STALE:
            self._withheld += wire
        elif fault is LineFault.LATE:
            await asyncio.sleep(self._faults.late_by_s)
            await self._write([wire])
        elif fault is LineFault.GARBAGE:
            await self._write([GARBAGE_BYTES])
        elif fault in _HALVES:
            await self._write([wire[: len(wire) // 2]])
        if fault in _RESETS:
            # closing sends RST: the peer's next read or write fails at once
            line: socket.socket = self._writer.get_extra_info("socket")
            line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        if fault in _ENDS_LINE:
            raise LineEndedError(fault.value)

    async def _write(self, parts: Iterable[bytes]) -> None:
        for part in parts:
            self._writer.write(part)
            await self._writer.drain()
