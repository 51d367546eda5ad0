"""Writes answers to a stream and carries out the faults armed for them."""

import asyncio
import socket
import struct
from collections.abc import Iterable

from analyzer_sim.lines.line_faults import GARBAGE_BYTES, LineFault, LineFaults

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
