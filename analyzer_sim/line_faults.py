"""Faults of the line between instrument and client, armed from a test, each spent by one answer.

Law of this file: nothing happens unless armed; a fault that needs a block waits for the next answer that has one.
"""

import threading
from collections import deque
from enum import Enum


class LineFault(Enum):
    """What may happen to one answer."""

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


_NEED_BLOCK = frozenset({LineFault.RESET_IN_BLOCK, LineFault.HALF_BLOCK})

#: what GARBAGE sends: bytes outside ASCII, a block header without digits, one line feed at the end
GARBAGE_BYTES = b"\xff\xfe#x;;\x00\x80" * 8 + b"\n"


class LineFaults:
    """Faults to come, in order; may be armed from any thread.

    Examples
    --------
    >>> faults = LineFaults()
    >>> faults.arm(LineFault.SILENT)
    >>> faults.take(b"1"), faults.take(b"1")
    (<LineFault.SILENT: 'silent'>, None)
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._armed: deque[LineFault] = deque()

    def arm(self, fault: LineFault, times: int = 1) -> None:
        """Let the next answers suffer this fault."""
        with self._lock:
            self._armed.extend([fault] * times)

    def disarm(self) -> None:
        """Forget all faults to come."""
        with self._lock:
            self._armed.clear()

    @property
    def remaining(self) -> int:
        """Faults armed and not yet spent."""
        with self._lock:
            return len(self._armed)

    def take(self, answer: bytes) -> LineFault | None:
        """Spend the next fault on this answer, if it applies to it."""
        with self._lock:
            if not self._armed or (self._armed[0] in _NEED_BLOCK and not answer.startswith(b"#")):
                return None
            return self._armed.popleft()
