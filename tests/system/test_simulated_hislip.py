"""The simulated analyzer over HiSLIP: a client of bytes for what no library says, and pyvisa-py for what they say.

The client below shares no code with the simulator: what both got wrong alike would not be seen.
"""

import socket
import struct
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import pytest

from analyzer_sim.dialects.dialect_rs import RS
from analyzer_sim.emission import Emission, Signal
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import TracePainter
from analyzer_sim.lines.line_faults import LineFault
from analyzer_sim.lines.server import AnalyzerThread, start_in_thread

pytestmark = pytest.mark.system

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
        self.line = socket.create_connection(("127.0.0.1", port), timeout=5.0)
        self.line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def __enter__(self) -> "Wire":
        return self

    def __exit__(self, *_: object) -> None:
        self.line.close()

    def say(self, kind: int, control: int = 0, parameter: int = 0, payload: bytes = b"") -> None:
        self.line.sendall(struct.pack("!2sBBIQ", b"HS", kind, control, parameter, len(payload)) + payload)

    def hear(self) -> Heard:
        prologue, kind, control, parameter, length = struct.unpack("!2sBBIQ", self._exactly(16))
        assert prologue == b"HS"
        return Heard(kind, control, parameter, self._exactly(length))

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            piece = self.line.recv(count - len(data))
            if not piece:
                raise EOFError
            data += piece
        return data

    def hears_nothing(self, for_s: float = 0.15) -> bool:
        self.line.settimeout(for_s)
        try:
            return self.line.recv(1) == b"never"
        except TimeoutError:
            return True
        finally:
            self.line.settimeout(5.0)

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
        self.opened = self.sync.hear()
        assert self.opened.kind == INITIALIZED
        self.side.say(ASYNC_INITIALIZE, 0, self.opened.parameter & 0xFFFF)
        assert self.side.hear()[:2] == (ASYNC_INITIALIZED, 0)
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
            heard = self.sync.hear()
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
        heard = self.side.hear()
        assert heard.kind == STATUS_TOLD, heard
        return heard.control

    def lock(self, timeout_ms: int = 0, key: bytes = b"") -> int:
        self.side.say(LOCK, 1, timeout_ms, key)
        return self.lock_answer()

    def unlock(self) -> int:
        self.side.say(LOCK, 0, self.last_id)
        return self.lock_answer()

    def lock_answer(self) -> int:
        heard = self.side.hear()
        assert heard.kind == LOCKED, heard
        return heard.control

    def clear(self) -> None:
        self.side.say(CLEAR)
        assert self.side.hear()[:3] == (CLEAR_ACKNOWLEDGED, 0, 0)
        self.sync.say(CLEAR_COMPLETE)
        while self.sync.hear().kind != CLEAR_DONE:
            pass
        self.next_id, self.last_id, self.delivered = FIRST_ID, FIRST_ID - 2, 0


class StandingSource:
    """Sixteen carriers, the same in every row."""

    def __init__(self) -> None:
        self.row = 0
        self.signals = tuple(Signal(f"c{n}", 956e6 + 2e6 * n, 1.2e6, 0.2, -45.0) for n in range(16))

    def advance(self) -> Emission:
        self.row += 1
        return self.current()

    def current(self) -> Emission:
        return Emission(1_793_491_200_000_000 + 60_000_000 * self.row, self.signals, -135.0)


class Held:
    """An analyzer whose sweeps wait until they are allowed."""

    def __init__(self) -> None:
        self.allowed = threading.Event()
        self.allowed.set()
        self.source = StandingSource()
        self.instrument = Instrument(self.source, TracePainter(1), self.allowed.is_set)


@pytest.fixture
def held() -> Held:
    return Held()


@pytest.fixture
def analyzer(held: Held) -> Iterator[AnalyzerThread]:
    with start_in_thread(held.instrument, hislip_port=0) as handle:
        yield handle


@pytest.fixture
def client(analyzer: AnalyzerThread) -> Iterator[Client]:
    with Client(analyzer.hislip_port) as made:
        yield made


def test_answers_carry_the_identifier_of_their_question(client: Client) -> None:
    assert client.opened.control == 0, "overlap is declined"
    assert client.opened.parameter >> 16 == 0x0100
    for number in range(200):
        assert client.ask(b"*ESE %d;*ESE?" % (number % 128)) == b"%d" % (number % 128)
    assert client.next_id == (FIRST_ID + 400) & 0xFFFFFFFF, "the identifiers have wrapped around"


def test_newer_client_is_offered_1_1(analyzer: AnalyzerThread) -> None:
    with Client(analyzer.hislip_port, 0x0200) as client:
        assert client.opened.parameter >> 16 == 0x0101
        assert client.ask(b"*IDN?") == IDENTITY


def test_the_raw_socket_is_the_same_instrument(analyzer: AnalyzerThread, client: Client) -> None:
    client.write(b"SWE:POIN 501;:NONE")
    assert client.ask(b"SWE:POIN?") == b"501"
    with socket.create_connection(("127.0.0.1", analyzer.port), timeout=5.0) as line:
        line.sendall(b"SWE:POIN?;:SYST:ERR?\n")
        assert line.recv(200).startswith(b"501;-113")


def test_a_trace_is_cut_to_what_the_client_takes(client: Client) -> None:
    client.side.say(SIZE, 0, 0, struct.pack("!Q", 1016))
    told = client.side.hear()
    assert told.kind == SIZE_TOLD
    assert struct.unpack("!Q", told.payload)[0] >= 1 << 20
    client.write(SETUP + b";:INIT")
    client.write(b"TRAC? TRACE1")
    block = b""
    kinds = []
    while not kinds or kinds[-1] == DATA:
        heard = client.sync.hear()
        kinds.append(heard.kind)
        block += heard.payload
        assert len(heard.payload) <= 1000
    assert kinds == [DATA] * 9 + [DATA_END]
    assert block[:6] == b"#49604"
    assert np.all(np.isfinite(np.frombuffer(block[6:-1], "<f4")))


def test_a_question_may_come_in_parts_and_without_line_feed(client: Client) -> None:
    client.write(b"*ESE 5;*", DATA)
    client.write(b"ES", DATA)
    assert client.ask(b"E?") == b"5"


def test_messages_are_executed_strictly_in_order(client: Client) -> None:
    for number in range(300):
        client.write(b"*ESE %d" % (number % 100))
    assert client.ask(b"*ESE?;:SYST:ERR:COUN?") == b"99;0"


# interrupted


def test_a_question_while_an_answer_is_unread_interrupts(client: Client) -> None:
    client.write(b"*IDN?")
    first = client.sync.hear()
    assert first.payload == IDENTITY + b"\n"
    second_id = client.write(b"*OPC?")  # RMT-delivered is not set: the client says it never read the answer
    assert client.sync.hear() == Heard(INTERRUPTED, 0, second_id, b"")
    assert client.side.hear() == Heard(ASYNC_INTERRUPTED, 0, second_id, b"")
    assert client.read() == b"1"
    assert client.ask(b"SYST:ERR?").startswith(b'-410,"Query INTERRUPTED')
    assert client.ask(b"SYST:ERR?").startswith(b"0,")


def test_an_answer_not_yet_given_is_never_given_once_interrupted(held: Held, client: Client) -> None:
    held.allowed.clear()
    client.write(SETUP)
    client.write(b"INIT;*OPC?")
    second_id = client.write(b"*ESE?")
    assert client.sync.hears_nothing()
    held.allowed.set()
    assert client.sync.hear() == Heard(INTERRUPTED, 0, second_id, b"")
    assert client.side.hear().kind == ASYNC_INTERRUPTED
    assert client.read() == b"0"


def test_two_questions_in_one_message_interrupt_each_other(client: Client) -> None:
    assert client.ask(b"*ESE?\n*OPC?\n") == b"1"
    assert client.ask(b"SYST:ERR?").startswith(b"-410")


def test_status_query_tells_delivery_too(client: Client) -> None:
    assert client.ask(b"*ESE?") == b"0"
    assert client.status() & 16 == 0
    client.delivered = 0  # as pyvisa-py does: it says so once, in the status query
    assert client.ask(b"*OPC?;:SYST:ERR:COUN?") == b"1;0"


# status and service requests


def test_status_byte_tells_that_an_answer_waits(client: Client) -> None:
    client.write(b"*CLS;*ESE?")
    heard = client.sync.hear()
    assert heard.kind == DATA_END
    assert client.status() & 16 == 16
    client.delivered = 1
    assert client.status() & 16 == 0


def test_status_is_told_while_a_sweep_holds_the_session(held: Held, client: Client) -> None:
    held.allowed.clear()
    client.write(SETUP + b";*ESE 1;:INIT;*OPC")
    client.write(b"*WAI;*ESE?")
    assert client.status() & 32 == 0
    held.allowed.set()
    assert client.read() == b"1"
    assert client.status() & 32 == 32


def test_service_is_requested_when_the_sweep_is_over(held: Held, client: Client) -> None:
    held.allowed.clear()
    client.write(SETUP + b";*ESE 1;*SRE 32;:INIT;*OPC")
    assert client.side.hears_nothing()
    held.allowed.set()
    heard = client.side.hear()
    assert (heard.kind, heard.control & 0x60, heard.parameter) == (SERVICE, 0x60, 0)
    assert client.status() & 0x60 == 0x60
    assert client.status() & 0x60 == 0x20, "the request is spent by the first poll"
    assert client.side.hears_nothing(0.05)
    assert client.ask(b"*STB?") == b"96", "*STB? shows the summary, which stays"


def test_an_error_of_another_session_requests_service_of_all(analyzer: AnalyzerThread, client: Client) -> None:
    client.write(b"*CLS;*SRE 4")
    with Client(analyzer.hislip_port) as other:
        other.write(b"NONE")
        assert other.side.hear().kind == SERVICE
    heard = client.side.hear()
    assert (heard.kind, heard.control & 0x44) == (SERVICE, 0x44)


# device clear and trigger


def test_device_clear_in_mid_sweep(held: Held, client: Client) -> None:
    held.allowed.clear()
    client.write(SETUP + b";:INIT")
    client.write(b"*OPC?")
    client.write(b"*IDN", DATA)
    assert client.sync.hears_nothing()
    client.clear()
    assert client.ask(b"*ESE?;:STAT:OPER:COND?") == b"0;32", "the session is free, the sweep still waits"
    held.allowed.set()
    assert client.ask(b"*OPC?") == b"1"
    assert held.source.row == 1
    assert len(client.ask(b"TRAC? TRACE1")) == len("#49604") + 4 * 2401


def test_device_clear_drops_what_was_sent_before_it(client: Client) -> None:
    client.write(b"*ESE?")
    client.side.say(CLEAR)
    assert client.side.hear().kind == CLEAR_ACKNOWLEDGED
    client.write(b"*ESE 77;*IDN?")
    client.sync.say(CLEAR_COMPLETE)
    heard = [client.sync.hear()]
    while heard[-1].kind != CLEAR_DONE:
        heard.append(client.sync.hear())
    assert IDENTITY + b"\n" not in {message.payload for message in heard}
    client.next_id, client.delivered = FIRST_ID, 0
    assert client.ask(b"*ESE?;:SYST:ERR:COUN?") == b"0;0"


def test_device_clear_again_and_again(client: Client) -> None:
    for _ in range(20):
        client.write(b"*IDN?")
        client.clear()
    assert client.ask(b"*OPC?") == b"1"


def test_trigger_starts_a_sweep_in_its_turn(held: Held, client: Client) -> None:
    client.write(SETUP)
    client.write(b"", TRIGGER)
    assert client.ask(b"*OPC?") == b"1"
    assert held.source.row == 1


# locks


def test_exclusive_lock_holds_the_others_back_until_it_is_given_back(analyzer: AnalyzerThread, client: Client) -> None:
    assert client.lock() == 1
    with Client(analyzer.hislip_port) as other:
        assert other.lock() == 0, "no patience, no lock"
        other.write(b"*ESE 9;*ESE?")
        assert other.sync.hears_nothing()
        assert other.status() & 16 == 0, "status is told to everybody"
        other.side.say(LOCK_INFO)
        assert other.side.hear()[:3] == (LOCK_TOLD, 1, 1)
        assert client.ask(b"*ESE?") == b"0"
        client.write(b"*ESE 3")
        assert client.unlock() == 1, "released after the message sent under it"
        assert other.read() == b"9"
    assert client.unlock() == 3


def test_a_lock_is_waited_for_as_long_as_asked(analyzer: AnalyzerThread, client: Client) -> None:
    assert client.lock() == 1
    with Client(analyzer.hislip_port) as other:
        began_s = time.monotonic()
        assert other.lock(timeout_ms=150) == 0
        assert 0.14 < time.monotonic() - began_s < 2.0
        other.side.say(LOCK, 1, 5000)
        assert other.side.hears_nothing(0.05)
        assert client.unlock() == 1
        assert other.lock_answer() == 1


def test_shared_locks_and_a_lock_on_top(analyzer: AnalyzerThread, client: Client) -> None:
    with Client(analyzer.hislip_port) as second, Client(analyzer.hislip_port) as stranger:
        assert client.lock(key=b"crew") == 1
        assert second.lock(key=b"crew") == 1
        assert stranger.lock(key=b"other") == 0
        assert (client.ask(b"*OPC?"), second.ask(b"*OPC?")) == (b"1", b"1")
        stranger.write(b"*OPC?")
        assert stranger.sync.hears_nothing(0.05)
        assert second.lock() == 1
        client.side.say(LOCK_INFO)
        assert client.side.hear()[:3] == (LOCK_TOLD, 1, 2)
        assert (second.unlock(), second.unlock(), client.unlock()) == (1, 2, 2)
        assert stranger.read() == b"1"


def test_a_client_that_leaves_takes_its_lock_along(analyzer: AnalyzerThread, client: Client) -> None:
    with Client(analyzer.hislip_port) as other:
        assert other.lock() == 1
        client.write(b"*OPC?")
        assert client.sync.hears_nothing(0.05)
    assert client.read() == b"1"


def test_the_raw_socket_is_held_back_by_a_lock(analyzer: AnalyzerThread, client: Client) -> None:
    assert client.lock() == 1
    with socket.create_connection(("127.0.0.1", analyzer.port), timeout=0.1) as line:
        line.sendall(b"*OPC?\n")
        with pytest.raises(TimeoutError):
            line.recv(10)
        assert client.unlock() == 1
        line.settimeout(5.0)
        assert line.recv(10) == b"1\n"


# what is wrong


def test_unknown_messages_are_refused_and_the_session_goes_on(client: Client) -> None:
    client.sync.say(26, 0, 0, b"descriptors")
    assert client.sync.hear()[:2] == (ERROR, 1)
    client.sync.say(200, 0, 0, b"vendor")
    assert client.sync.hear()[:2] == (ERROR, 3)
    client.side.say(DATA_END, 0, FIRST_ID, b"*IDN?")
    assert client.side.hear()[:2] == (ERROR, 1), "data has no business on this channel"
    client.side.say(REMOTE, 9)
    assert client.side.hear()[:2] == (ERROR, 2)
    client.side.say(LOCK, 2)
    assert client.side.hear()[:2] == (ERROR, 2)
    client.side.say(SIZE, 0, 0, b"12")
    assert client.side.hear()[:2] == (ERROR, 0)
    for control in range(7):
        client.side.say(REMOTE, control, client.last_id)
        assert client.side.hear()[:2] == (REMOTE_DONE, 0)
    client.sync.say(ERROR, 0, 0, b"the client complains")
    assert client.ask(b"*IDN?") == IDENTITY


def test_oversize_payload_is_refused_and_skipped(client: Client) -> None:
    client.write(b"*ESE 5;" + b" " * 3_000_000)
    assert client.sync.hear()[:2] == (ERROR, 4)
    assert client.ask(b"*ESE?") == b"0"


def test_message_of_many_parts_beyond_the_limit_is_too_much_data(client: Client) -> None:
    for _ in range(3):
        client.write(b"x" * 500_000, DATA)
    client.write(b"x")
    assert client.ask(b"SYST:ERR?").startswith(b"-223")


@pytest.mark.parametrize(
    "garbage",
    [b"GET / HTTP/1.1\r\n\r\n", b"*IDN?\n", bytes(64), struct.pack("!2sBBIQ", b"HS", 7, 0, 0, 2**64 - 1)],
)
def test_garbage_ends_its_own_session_only(analyzer: AnalyzerThread, client: Client, garbage: bytes) -> None:
    with Client(analyzer.hislip_port) as other:
        other.sync.line.sendall(garbage)
        assert other.sync.hear()[:2] == (FATAL, 1)
        assert other.sync.is_closed()
        assert other.side.is_closed()
    with Wire(analyzer.hislip_port) as fresh:
        fresh.line.sendall(garbage)
        assert fresh.hear().kind == FATAL
        assert fresh.is_closed()
    assert client.ask(b"*IDN?") == IDENTITY


def test_wrong_beginnings_are_fatal(analyzer: AnalyzerThread, client: Client) -> None:
    def fate(kind: int, parameter: int = 0, payload: bytes = b"") -> int:
        with Wire(analyzer.hislip_port) as wire:
            wire.say(kind, 0, parameter, payload)
            heard = wire.hear()
            assert heard.kind == FATAL
            assert wire.is_closed()
            return heard.control

    assert fate(DATA_END, FIRST_ID, b"*IDN?") == 3
    assert fate(ASYNC_INITIALIZE, 54321) == 3
    assert fate(ASYNC_INITIALIZE, client.opened.parameter & 0xFFFF) == 3, "the session has its channel already"
    assert fate(INITIALIZE, 0x0100 << 16, b"hislip7") == 3
    with Wire(analyzer.hislip_port) as half:
        half.say(INITIALIZE, 0, 0x0100 << 16, b"hislip0")
        assert half.hear().kind == INITIALIZED
        half.say(DATA_END, 0, FIRST_ID, b"*IDN?")
        assert half.hear()[:2] == (FATAL, 2)
    client.sync.say(INITIALIZE, 0, 0x0100 << 16, b"hislip0")
    assert client.sync.hear()[:2] == (FATAL, 3)
    assert client.side.is_closed()


def test_a_client_that_leaves_in_mid_sweep_leaves_the_instrument_to_others(
    held: Held, analyzer: AnalyzerThread
) -> None:
    held.allowed.clear()
    with Client(analyzer.hislip_port) as leaving:
        leaving.write(SETUP)
        leaving.write(b"INIT;*OPC?")
        assert leaving.sync.hears_nothing(0.05)
    with Client(analyzer.hislip_port) as client:
        assert client.ask(b"STAT:OPER:COND?") == b"32"
        client.write(b"ABOR")
        assert client.ask(b"*OPC?") == b"1"
        assert held.source.row == 0


def test_fatal_error_of_the_client_closes_both_channels(client: Client) -> None:
    client.side.say(FATAL, 0, 0, b"enough")
    assert client.side.is_closed()
    assert client.sync.is_closed()


@pytest.mark.parametrize("fault", [LineFault.RESET, LineFault.CLOSE])
def test_a_fault_that_ends_the_line_ends_both_channels(
    analyzer: AnalyzerThread, client: Client, fault: LineFault
) -> None:
    analyzer.faults.arm(fault)
    client.write(b"*IDN?")
    assert client.sync.is_closed()
    assert client.side.is_closed()


def test_a_stale_answer_has_the_old_identifier(analyzer: AnalyzerThread, client: Client) -> None:
    analyzer.faults.arm(LineFault.STALE)
    first_id = client.write(b"*ESE?")
    assert client.sync.hears_nothing(0.05)
    second_id = client.write(b"*IDN?")
    heard = [client.sync.hear() for _ in range(3)]
    assert [(message.kind, message.parameter) for message in heard] == [
        (INTERRUPTED, second_id),
        (DATA_END, first_id),
        (DATA_END, second_id),
    ]


def random_message(rng: np.random.Generator) -> bytes:
    payload = [
        b"",
        b"*IDN?\n",
        b"*OPC?;*ESE?",
        b"INIT",
        b"TRAC? TRACE1",
        bytes(8),
        bytes(rng.integers(0, 256, 40, "u1")),
    ]
    kind = int(rng.integers(2, 27))
    parameter = int(rng.choice([0, 1, FIRST_ID, 2**32 - 1]))
    chosen = payload[int(rng.integers(len(payload)))]
    length = len(chosen) if rng.random() < 0.95 else int(rng.integers(0, 2**40))
    return struct.pack("!2sBBIQ", b"HS", kind, int(rng.integers(0, 3)), parameter, length) + chosen


def test_any_messages_in_any_order_leave_the_instrument_to_others(analyzer: AnalyzerThread, client: Client) -> None:
    seed = 20261122
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    for _ in range(150):
        with Client(analyzer.hislip_port) as wild:
            try:
                for _ in range(int(rng.integers(1, 30))):
                    wire = wild.sync if rng.random() < 0.6 else wild.side
                    wire.line.sendall(random_message(rng))
            except (BrokenPipeError, ConnectionResetError):
                pass  # a fatal error has ended it
    client.write(b"ABOR;*CLS;:INIT:CONT OFF")
    assert client.ask(b"*IDN?") == IDENTITY
    client.side.say(LOCK_INFO)
    heard = client.side.hear()
    while heard.kind == SERVICE:
        heard = client.side.hear()
    assert heard[:3] == (LOCK_TOLD, 0, 0), "those who left hold no lock"


def test_a_client_that_reads_nothing_is_cleared_or_leaves(analyzer: AnalyzerThread, client: Client) -> None:
    with Client(analyzer.hislip_port) as deaf:
        deaf.write(SETUP + b";:SWE:POIN 100001;:INIT")
        deaf.write(b";".join([b"TRAC? TRACE1"] * 30))  # 12 MB: more than buffers on the way hold
        for _ in range(200):
            deaf.write(b"*CLS")
        assert client.ask(b"*IDN?") == IDENTITY
        deaf.side.say(CLEAR)
        while deaf.side.hear().kind != CLEAR_ACKNOWLEDGED:
            pass
        deaf.sync.say(CLEAR_COMPLETE)
        while deaf.sync.hear().kind != CLEAR_DONE:
            pass
        deaf.next_id, deaf.delivered = FIRST_ID, 0
        assert deaf.ask(b"*ESE?") == b"0"
        deaf.write(b";".join([b"TRAC? TRACE1"] * 30))
        deaf.write(b"*CLS")
    assert client.ask(b"*OPC?") == b"1"


def test_a_response_beyond_the_output_queue_is_a_deadlock(client: Client) -> None:
    client.write(SETUP + b";:SWE:POIN 100001;:INIT")
    client.write(b";".join([b"TRAC? TRACE1"] * 45) + b";*ESE 5")  # 18 MB
    assert client.ask(b"*ESE?;:SYST:ERR?").startswith(b'0;-430,"Query DEADLOCKED')


# many, and libraries


def test_sessions_at_once_get_their_own_answers(analyzer: AnalyzerThread) -> None:
    def talk(number: int) -> int:
        with Client(analyzer.hislip_port) as client:
            return sum(client.ask(b"*IDN?;:STAT:QUES:ENAB?;:FORM?") == IDENTITY + b";0;ASC,0" for _ in range(30))

    with ThreadPoolExecutor(12) as pool:
        assert list(pool.map(talk, range(12))) == [30] * 12


def test_the_sixty_fifth_session_is_refused(analyzer: AnalyzerThread) -> None:
    clients = [Client(analyzer.hislip_port) for _ in range(64)]
    with Wire(analyzer.hislip_port) as wire:
        wire.say(INITIALIZE, 0, 0x0100 << 16, b"hislip0")
        assert wire.hear()[:2] == (FATAL, 4)
    assert all(client.ask(b"*OPC?") == b"1" for client in clients)
    for client in clients:
        client.__exit__()


def test_pyvisa_reads_the_same_trace_in_both_formats(analyzer: AnalyzerThread) -> None:
    # the first script of section 8 of the analyzer specification, its HiSLIP part, word for word
    import pyvisa

    manager = pyvisa.ResourceManager("@py")
    i = manager.open_resource(
        f"TCPIP::127.0.0.1::hislip0,{analyzer.hislip_port}::INSTR",
        read_termination="\n",
        write_termination="\n",
        timeout=5000,
        chunk_size=1 << 20,
    )
    i.write("*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20e6;:BAND 30 KHZ;:SWE:POIN 2001;TIME 0.2;:DET RMS")
    assert i.query("INIT;*OPC?").strip() == "1"
    i.write("FORM REAL,32")
    y = i.query_binary_values("TRAC? TRACE1", "f", is_big_endian=False, container=np.array)
    i.write("FORM ASC")
    a = np.array(i.query_ascii_values("TRAC:DATA? TRACE1"))
    assert len(y) == len(a) == 2001
    assert np.max(np.abs(y - a)) < 1e-4
    assert i.query("SYST:ERR?").startswith("0,")
    i.close()


def test_pyvisa_times_out_polls_clears_and_goes_on(held: Held, analyzer: AnalyzerThread) -> None:
    import pyvisa

    i = pyvisa.ResourceManager("@py").open_resource(
        f"TCPIP::127.0.0.1::hislip0,{analyzer.hislip_port}::INSTR",
        read_termination="\n",
        write_termination="\n",
        timeout=200,
    )
    held.allowed.clear()
    i.write("*RST;*CLS;*ESE 1;:INIT:CONT OFF;:SWE:POIN 501;:INIT;*OPC")
    assert i.read_stb() & 32 == 0
    with pytest.raises(pyvisa.VisaIOError):
        i.query("*OPC?")
    i.clear()
    i.timeout = 5000
    assert i.query("*IDN?") == RS.identity, "no stale answer after a clear"
    held.allowed.set()
    assert i.query("*OPC?") == "1"
    assert i.query("*ESR?") == "0", "a device clear takes *OPC back"
    i.write("INIT;*OPC")
    while not i.read_stb() & 32:
        time.sleep(0.001)
    assert i.query("*ESR?") == "1"
    assert len(i.query_ascii_values("TRAC? TRACE1")) == 501
    assert i.query("SYST:ERR?").startswith("0,")
    i.close()


def test_pyvisa_never_reads_a_stale_answer_over_hislip_and_does_over_the_socket(
    held: Held, analyzer: AnalyzerThread
) -> None:
    import pyvisa

    manager = pyvisa.ResourceManager("@py")
    answers = []
    for resource in (
        f"TCPIP::127.0.0.1::hislip0,{analyzer.hislip_port}::INSTR",
        f"TCPIP::127.0.0.1::{analyzer.port}::SOCKET",
    ):
        held.allowed.clear()
        i = manager.open_resource(resource, read_termination="\n", write_termination="\n", timeout=100)
        i.write("*RST;*CLS;:INIT:CONT OFF;:SWE:POIN 501;:INIT")
        with pytest.raises(pyvisa.VisaIOError):
            i.query("*OPC?")
        held.allowed.set()
        i.timeout = 5000
        answers.append(i.query("*IDN?"))
        i.close()
    assert answers == [RS.identity, "1"]
