"""A HiSLIP client of bytes, and an analyzer for it whose sweeps wait until they are allowed.

The client shares no code with the simulator: what both got wrong alike would not be seen.
"""

import socket
import struct
import threading
import time
from typing import NamedTuple

from standing_source import StandingSource

from analyzer_sim.dialects.rs import RS
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import TracePainter

IDENTITY = RS.identity.encode()
FIRST_ID = 0xFFFFFF00
SETUP = (
    b"*RST;*CLS;:INIT:CONT OFF;:FREQ:STAR 954 MHZ;STOP 990 MHZ;:BAND 30 KHZ"
    b";:SWE:POIN 2401;TIME 2;:DET RMS;:FORM REAL,32"
)
# numbers of table 4 of IVI-6.1
INITIALIZE, INITIALIZED, FATAL, ERROR, LOCK, LOCKED, DATA, DATA_END, CLEAR_COMPLETE, CLEAR_DONE = range(10)
REMOTE, REMOTE_DONE, TRIGGER, INTERRUPTED, ASYNC_INTERRUPTED, SIZE, SIZE_TOLD, ASYNC_INITIALIZE = range(10, 18)
ASYNC_INITIALIZED, CLEAR, SERVICE, STATUS, STATUS_TOLD, CLEAR_ACKNOWLEDGED, LOCK_INFO, LOCK_TOLD = range(18, 26)


class Heard(NamedTuple):
    kind: int
    control: int
    parameter: int
    payload: bytes


class Wire:
    """One connection."""

    def __init__(self, port: int) -> None:
        self.line = socket.create_connection(("127.0.0.1", port), timeout=120.0)
        self.line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def __enter__(self) -> "Wire":
        return self

    def __exit__(self, *_: object) -> None:
        self.line.close()

    def say(self, kind: int, control: int = 0, parameter: int = 0, payload: bytes = b"") -> None:
        self.line.sendall(struct.pack("!2sBBIQ", b"HS", kind, control, parameter, len(payload)) + payload)

    def on_input(self) -> Heard:
        prologue, kind, control, parameter, length = struct.unpack("!2sBBIQ", self._exactly(16))
        assert prologue == b"HS"
        return Heard(kind, control, parameter, self._exactly(length))

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            chunk = self.line.recv(count - len(data))
            if not chunk:
                raise EOFError
            data += chunk
        return data

    def hears_nothing(self, for_s: float = 0.15) -> bool:
        self.line.settimeout(for_s)
        try:
            return self.line.recv(1) == b"never"
        except TimeoutError:
            return True
        finally:
            self.line.settimeout(120.0)

    def is_closed(self) -> bool:
        try:
            return self.line.recv(1) == b""
        except ConnectionResetError:
            return True


class Client:
    """One session: numbers its messages and tells what it has read, as IVI-6.1 wants it."""

    def __init__(self, port: int, version: int = 0x0100) -> None:
        self.sync, self.side = Wire(port), Wire(port)
        self.sync.say(INITIALIZE, 0, version << 16 | 0x7878, b"hislip0")
        self.opened = self.sync.on_input()
        assert self.opened.kind == INITIALIZED
        self.side.say(ASYNC_INITIALIZE, 0, self.opened.parameter & 0xFFFF)
        assert self.side.on_input()[:2] == (ASYNC_INITIALIZED, 0)
        self.next_id, self.last_id, self.delivered = FIRST_ID, FIRST_ID - 2, 0

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self.sync.line.close()
        self.side.line.close()

    def write(self, data: bytes, kind: int = DATA_END) -> int:
        self.sync.say(kind, self.delivered, self.next_id, data)
        self.delivered, self.last_id = 0, self.next_id
        self.next_id = (self.next_id + 2) & 0xFFFFFFFF
        return self.last_id

    def read(self) -> bytes:
        answer = b""
        while True:
            heard = self.sync.on_input()
            assert heard.kind in {DATA, DATA_END}, heard
            assert heard.parameter == self.last_id
            answer += heard.payload
            if heard.kind == DATA_END:
                self.delivered = 1
                return answer.removesuffix(b"\n")

    def ask(self, question: bytes) -> bytes:
        self.write(question)
        return self.read()

    def status(self) -> int:
        self.side.say(STATUS, self.delivered, self.last_id)
        heard = self.side.on_input()
        assert heard.kind == STATUS_TOLD, heard
        return heard.control

    def lock(self, timeout_ms: int = 0, key: bytes = b"") -> int:
        self.side.say(LOCK, 1, timeout_ms, key)
        return self.lock_answer()

    def unlock(self) -> int:
        self.side.say(LOCK, 0, self.last_id)
        return self.lock_answer()

    def lock_answer(self) -> int:
        heard = self.side.on_input()
        assert heard.kind == LOCKED, heard
        return heard.control

    def clear(self) -> None:
        self.side.say(CLEAR)
        assert self.side.on_input()[:3] == (CLEAR_ACKNOWLEDGED, 0, 0)
        self.sync.say(CLEAR_COMPLETE)
        while self.sync.on_input().kind != CLEAR_DONE:
            pass
        self.next_id, self.last_id, self.delivered = FIRST_ID, FIRST_ID - 2, 0


class Held:
    """An analyzer whose sweeps wait until they are allowed."""

    def __init__(self) -> None:
        self.allowed = threading.Event()
        self.allowed.set()
        self.source = StandingSource.endless()
        self.instrument = Instrument(self.source, TracePainter(1), self.allowed.is_set)

    def await_sweep(self) -> None:
        """Return when a sweep waits."""
        deadline_s = time.monotonic() + 120.0
        while not self.instrument.is_pending:
            assert time.monotonic() < deadline_s
            time.sleep(0.001)
