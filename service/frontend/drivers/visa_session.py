"""One VISA session to one analyzer: messages out, answers in, every wait bounded.

Law of this file: any failure of transport or framing becomes `AnalyzerIOError`, and after one the session is of no
use - the caller closes it and opens another. On a raw socket the answer to a query that timed out is still in the
stream and would be read as the answer to the next one.

What the pyvisa stack does, and what is done about it: opening a closed port succeeds, so nothing is believed before
``*IDN?`` was answered; a peer that closes in good order is not noticed, and the read turns round in circles until its
time is over, so every wait for an answer looks at the socket itself first; a name that cannot be resolved raises a bare
Exception; a line read has no bound of its own, so it gets one here.
"""

import select
import socket
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

import pyvisa

from service.frontend.drivers.scpi import AnswerError, block_length, split_block

_Answer = TypeVar("_Answer")

#: what pyvisa, pyvisa-py and the socket below them raise; garbage on HiSLIP ends in a failed lookup or a short header
IO_ERRORS = (pyvisa.Error, OSError, ValueError, RuntimeError, LookupError, struct.error)
#: longest answer line that is read, bytes; an ASCII trace of 100 001 points takes 1.5 MB
MAX_LINE_BYTES = 2 << 20
#: a wait for a sweep looks for a stop and for a lost peer this often, s
SLICE_S = 0.5
#: longest block that is read, bytes
MAX_BLOCK_BYTES = 1 << 20


class AnalyzerIOError(Exception):
    """The session to the analyzer broke: no answer in time, connection lost, or an answer that cannot be framed."""


class VisaSession:
    """Open session to one analyzer.

    Parameters
    ----------
    resource : str
        VISA resource name, for example ``TCPIP::10.0.0.5::5025::SOCKET``.
    timeout_s : float
        Bound on connecting and on every answer that names no other.
    is_stopping : callable
        Whether the acquisition is to end; shortens `await_answer`.
    visa_library : str
        ``@py`` is pyvisa-py; a vendor's library may be named instead.

    Raises
    ------
    AnalyzerIOError
        The resource cannot be opened.
    """

    def __init__(
        self,
        resource: str,
        timeout_s: float,
        is_stopping: Callable[[], bool] = lambda: False,
        visa_library: str = "@py",
    ) -> None:
        self.resource = resource
        #: a raw socket is a stream without messages; HiSLIP, VXI-11, USB and GPIB mark their ends
        self._is_socket = resource.upper().endswith("::SOCKET")
        self._is_stopping = is_stopping
        self._timeout_s = timeout_s
        try:
            self._visa: Any = pyvisa.ResourceManager(visa_library).open_resource(
                resource,
                open_timeout=round(1000 * timeout_s),
                timeout=round(1000 * timeout_s),
                read_termination="\n",
                write_termination="\n",
                chunk_size=MAX_BLOCK_BYTES,
            )
        except Exception as error:
            raise _broken(resource, "cannot be opened", error) from error
        self._current_timeout_s = timeout_s
        line = self._interface()
        if isinstance(line, socket.socket):
            # A setting followed by a query would wait 40 ms for the peer's delayed acknowledgement.
            with suppress(OSError):
                line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def close(self) -> None:
        """Close the session; a session that broke may not close in good order, which changes nothing."""
        try:
            self._visa.close()
        except IO_ERRORS:
            return

    def abandon(self) -> None:
        """Cut the line from another thread, so that a call that hangs on it returns; as far as pyvisa-py shows it."""
        line = self._interface()
        for each in (line, getattr(line, "_sync", None), getattr(line, "_async", None)):
            if isinstance(each, socket.socket):
                with suppress(OSError):
                    each.shutdown(socket.SHUT_RDWR)

    def write(self, message: str) -> None:
        """Send one message that asks for nothing."""
        try:
            self._visa.write(message)
        except IO_ERRORS as error:
            raise _broken(self.resource, f"does not take {message!r}", error) from error

    def query(self, message: str, timeout_s: float | None = None) -> str:
        """Return the answer line of one message."""
        return self._answered(message, timeout_s or self._timeout_s, float("inf"), self._line)

    def await_answer(self, message: str, timeout_s: float, grace_s: float) -> str:
        """Return the answer line of a message that takes long; a stop leaves it ``grace_s`` more.

        Only a raw socket can be looked at while nothing comes; on other transports a stop waits for the answer.
        """
        return self._answered(message, timeout_s, grace_s, self._line)

    def _answered(self, message: str, timeout_s: float, grace_s: float, read: Callable[[], _Answer]) -> _Answer:
        """Send a message and return what is read after the first byte of its answer has come."""
        self.write(message)
        return self._read(message, timeout_s, grace_s, read)

    def read_line(self, message: str) -> str:
        """Return a line of answer more, to a message that was sent before."""
        return self._read(message, self._timeout_s, float("inf"), self._line)

    def _read(self, message: str, timeout_s: float, grace_s: float, read: Callable[[], _Answer]) -> _Answer:
        try:
            self._await_first_byte(timeout_s, grace_s)
            self._set_timeout(timeout_s)
            return read()
        except IO_ERRORS as error:
            raise _broken(self.resource, f"does not answer {message!r}", error) from error

    def _await_first_byte(self, timeout_s: float, grace_s: float) -> None:
        """Wait until there is something to read, in slices: for a stop, and for a peer that has left.

        A read of pyvisa-py would not notice the latter, and keep a processor busy until its time is over.
        """
        line = self._interface()
        if not self._is_socket or not isinstance(line, socket.socket) or self._has_pending():
            return
        deadline_s, is_stopping = time.monotonic() + timeout_s, False
        while not select.select([line], [], [], max(0.0, min(SLICE_S, deadline_s - time.monotonic())))[0]:
            if time.monotonic() >= deadline_s:
                message = f"nothing came in {timeout_s:g} s"
                raise TimeoutError(message)
            if self._is_stopping() and not is_stopping:
                is_stopping, deadline_s = True, min(deadline_s, time.monotonic() + grace_s)
        if self._is_left():
            message = "the analyzer closed the connection"
            raise ConnectionResetError(message)

    def _has_pending(self) -> bool:
        """Return whether pyvisa-py has read more of the stream than was asked for."""
        session = self._visa.visalib.sessions.get(self._visa.session)
        return bool(getattr(session, "_pending_buffer", b""))

    def _is_left(self) -> bool:
        """Return whether the peer closed the connection, as far as pyvisa-py shows its socket."""
        line = self._interface()
        if not isinstance(line, socket.socket):
            return False
        try:
            return line.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) == b""
        except BlockingIOError:
            return False
        except OSError:
            return True

    def _interface(self) -> object:
        """Return the object in which pyvisa-py holds the connection: a socket, or an instrument with two."""
        try:
            return getattr(self._visa.visalib.sessions.get(self._visa.session), "interface", None)
        except (pyvisa.Error, AttributeError):
            return None

    def query_block(self, message: str, timeout_s: float | None = None) -> tuple[bytes | None, str]:
        """Return the block that opens the answer and the rest of its line.

        The block is None, and the line whole, when the answer does not open with a block.
        """
        read = self._stream_block if self._is_socket else self._message_block
        return self._answered(message, timeout_s or self._timeout_s, float("inf"), read)

    def _stream_block(self) -> tuple[bytes | None, str]:
        """Read a block off a stream of bytes, whose messages end where their lengths say."""
        head = self._visa.read_bytes(2, break_on_termchar=True)
        if head[:1] != b"#" or not head[1:2].isdigit() or head == b"#0":
            return None, head.decode("ascii").removesuffix("\n") + ("" if head.endswith(b"\n") else self._line())
        digits = self._visa.read_bytes(block_length(head))
        length = int(digits)
        if length > MAX_BLOCK_BYTES:
            raise AnswerError(f"block of {length} bytes announced")
        payload, _ = split_block(head + digits + self._visa.read_bytes(length))
        return payload, self._line()

    def _message_block(self) -> tuple[bytes | None, str]:
        """Read a whole message; the transport says where it ends, so that half a block is never waited for."""
        answer: bytes = self._visa.read_bytes(MAX_BLOCK_BYTES + MAX_LINE_BYTES, break_on_termchar=True)
        if answer[:1] != b"#" or not answer[1:2].isdigit() or answer[:2] == b"#0":
            return None, answer.decode("ascii").rstrip("\r\n")
        payload, rest = split_block(bytes(answer))
        return payload, rest.decode("ascii").rstrip("\r\n")

    def _line(self) -> str:
        """Return the stream up to its next line feed, or the message up to its end."""
        line: bytes = self._visa.read_bytes(MAX_LINE_BYTES, break_on_termchar=True)
        if self._is_socket and not line.endswith(b"\n"):
            raise AnswerError(f"line without an end after {len(line)} bytes")
        return line.decode("ascii").rstrip("\r\n")

    def _set_timeout(self, wanted_s: float) -> None:
        """Bound the next reads."""
        if wanted_s != self._current_timeout_s:
            self._visa.timeout = round(1000 * wanted_s)
            self._current_timeout_s = wanted_s


def _broken(resource: str, what: str, error: Exception) -> AnalyzerIOError:
    """Return the error that names the analyzer, what it did not do, and why."""
    return AnalyzerIOError(f"{resource} {what}: {type(error).__name__} {error}")
