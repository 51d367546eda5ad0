"""Faults of the line between instrument and client, armed from a test, each spent by one answer.

Law of this file: nothing happens unless armed; a fault that needs a block waits for the next answer that has one.
``faulty_line.py`` carries them out, on the raw socket and on HiSLIP alike.
"""

import threading
from collections import deque
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
