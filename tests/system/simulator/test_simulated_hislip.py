"""HiSLIP over real sockets: dialogue, clear, locks, VISA libraries, what a client does wrong, faults of the line."""

import struct
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
import wire_lines as w
from analyzer_thread import AnalyzerThread, start_in_thread
from standing_source import StandingSource
from wire_lines import Channel, HislipLine, RawLine

from analyzer_sim.dialects.rs import RS
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import TracePainter
from analyzer_sim.lines.line_faults import LineFault

pytestmark = pytest.mark.system

IDENTITY = RS.identity
SETUP = (
    b"*RST;*CLS;:INIT:CONT OFF;:FREQ:STAR 954 MHZ;STOP 990 MHZ;:BAND 30 KHZ"
    b";:SWE:POIN 2401;TIME 2;:DET RMS;:FORM REAL,32"
)


@pytest.fixture
def allowed() -> threading.Event:
    """Return whether sweeps may complete."""
    event = threading.Event()
    event.set()
    return event


@pytest.fixture
def analyzer(allowed: threading.Event) -> Iterator[AnalyzerThread]:
    instrument = Instrument(StandingSource.endless(), TracePainter(1), allowed.is_set)
    with start_in_thread(instrument, hislip_port=0) as handle:
        yield handle


@pytest.fixture
def client(analyzer: AnalyzerThread) -> Iterator[HislipLine]:
    with HislipLine(analyzer.hislip_port) as made:
        yield made


def test_answers_carry_the_identifier_of_their_question(client: HislipLine) -> None:
    assert client.opened.control == 0, "overlap is declined"
    assert client.opened.parameter >> 16 == 0x0100
    for number in range(200):
        assert client.ask(f"*ESE {number % 128};*ESE?") == str(number % 128)
    assert client.next_id == (w.FIRST_ID + 400) & 0xFFFFFFFF, "the identifiers have wrapped around"


def test_newer_client_is_offered_1_1(analyzer: AnalyzerThread) -> None:
    with HislipLine(analyzer.hislip_port, 0x0200) as client:
        assert client.opened.parameter >> 16 == 0x0101
        assert client.ask("*IDN?") == IDENTITY


def test_the_raw_socket_is_the_same_instrument(analyzer: AnalyzerThread, client: HislipLine) -> None:
    client.write(b"SWE:POIN 501;:NONE")
    assert client.ask("SWE:POIN?") == "501"
    with RawLine(analyzer.port) as line:
        assert line.ask("SWE:POIN?;:SYST:ERR?").startswith("501;-113")


def test_messages_are_executed_strictly_in_order(client: HislipLine) -> None:
    for number in range(300):
        client.write(b"*ESE %d" % (number % 100))
    assert client.ask("*ESE?;:SYST:ERR:COUN?") == "99;0"


def test_an_answer_not_yet_given_is_never_given_once_interrupted(allowed: threading.Event, client: HislipLine) -> None:
    allowed.clear()
    client.write(SETUP)
    client.write(b"INIT;*OPC?")
    second_id = client.write(b"*ESE?")
    assert client.sync.hears_nothing()
    allowed.set()
    assert client.sync.on_input() == w.Heard(w.INTERRUPTED, 0, second_id, b"")
    assert client.side.on_input().kind == w.ASYNC_INTERRUPTED
    assert client.read() == b"0\n"


def test_two_questions_in_one_message_interrupt_each_other(client: HislipLine) -> None:
    assert client.ask("*ESE?\n*OPC?\n") == "1"
    assert client.ask("SYST:ERR?").startswith("-410")


def test_status_query_tells_delivery_too(client: HislipLine) -> None:
    assert client.ask("*ESE?") == "0"
    assert client.status() & 16 == 0
    # as pyvisa-py does: it says so once, in the status query
    assert client.ask("*OPC?;:SYST:ERR:COUN?") == "1;0"


def test_status_is_told_while_a_sweep_holds_the_session(allowed: threading.Event, client: HislipLine) -> None:
    allowed.clear()
    client.write(SETUP + b";*ESE 1;:INIT;*OPC")
    client.write(b"*WAI;*ESE?")
    assert client.status() & 32 == 0
    allowed.set()
    assert client.read() == b"1\n"
    assert client.status() & 32 == 32


def test_an_error_of_another_session_requests_service_of_all(analyzer: AnalyzerThread, client: HislipLine) -> None:
    client.write(b"*CLS;*SRE 4")
    with HislipLine(analyzer.hislip_port) as other:
        other.write(b"NONE")
        assert other.side.on_input().kind == w.SERVICE
    heard = client.side.on_input()
    assert (heard.kind, heard.control & 0x44) == (w.SERVICE, 0x44)


def test_device_clear_again_and_again(client: HislipLine) -> None:
    for _ in range(20):
        client.write(b"*IDN?")
        client.clear()
    assert client.ask("*OPC?") == "1"


def test_exclusive_lock_holds_others_back_until_it_is_given_back(analyzer: AnalyzerThread, client: HislipLine) -> None:
    assert client.lock() == 1
    with HislipLine(analyzer.hislip_port) as other:
        assert other.lock() == 0, "no patience, no lock"
        other.write(b"*ESE 9;*ESE?")
        assert other.sync.hears_nothing()
        assert other.status() & 16 == 0, "status is told to everybody"
        other.side.say(w.LOCK_INFO)
        assert other.side.on_input()[:3] == (w.LOCK_TOLD, 1, 1)
        assert client.ask("*ESE?") == "0"
        client.write(b"*ESE 3")
        assert client.unlock() == 1, "released after the message sent under it"
        assert other.read() == b"9\n"
    assert client.unlock() == 3


def test_a_lock_is_waited_for_as_long_as_asked(analyzer: AnalyzerThread, client: HislipLine) -> None:
    assert client.lock() == 1
    with HislipLine(analyzer.hislip_port) as other:
        began_s = time.monotonic()
        assert other.lock(timeout_ms=150) == 0
        assert time.monotonic() - began_s > 0.14
        other.side.say(w.LOCK, 1, 120_000)
        assert other.side.hears_nothing(0.05)
        assert client.unlock() == 1
        assert other.lock_answer() == 1


def test_a_client_that_leaves_takes_its_lock_along(analyzer: AnalyzerThread, client: HislipLine) -> None:
    with HislipLine(analyzer.hislip_port) as other:
        assert other.lock() == 1
        client.write(b"*OPC?")
        assert client.sync.hears_nothing(0.05)
    assert client.read() == b"1\n"


def test_the_raw_socket_is_held_back_by_a_lock(analyzer: AnalyzerThread, client: HislipLine) -> None:
    assert client.lock() == 1
    with RawLine(analyzer.port) as line:
        line.write(b"*OPC?\n")
        assert line.hears_nothing()
        assert client.unlock() == 1
        assert line.received(2) == b"1\n"


def test_the_sixty_fifth_session_is_refused(analyzer: AnalyzerThread) -> None:
    clients = [HislipLine(analyzer.hislip_port) for _ in range(64)]
    with Channel(analyzer.hislip_port) as wire:
        wire.say(w.INITIALIZE, 0, 0x0100 << 16, b"hislip0")
        assert wire.on_input()[:2] == (w.FATAL, 4)
    assert all(client.ask("*OPC?") == "1" for client in clients)
    for client in clients:
        client.close()


def test_pyvisa_times_out_polls_clears_and_goes_on(allowed: threading.Event, analyzer: AnalyzerThread) -> None:
    import pyvisa

    i = pyvisa.ResourceManager("@py").open_resource(
        f"TCPIP::127.0.0.1::hislip0,{analyzer.hislip_port}::INSTR",
        read_termination="\n",
        write_termination="\n",
        timeout=120_000,
    )
    allowed.clear()
    i.write("*RST;*CLS;*ESE 1;:INIT:CONT OFF;:SWE:POIN 501;:INIT;*OPC")
    assert i.read_stb() & 32 == 0
    i.timeout = 200
    with pytest.raises(pyvisa.VisaIOError):
        i.query("*OPC?")
    i.timeout = 120_000
    i.clear()
    assert i.query("*IDN?") == RS.identity, "no stale answer after a clear"
    allowed.set()
    assert i.query("*OPC?") == "1"
    assert i.query("*ESR?") == "0", "a device clear takes *OPC back"
    i.write("INIT;*OPC")
    while not i.read_stb() & 32:
        time.sleep(0.001)
    assert i.query("*ESR?") == "1"
    assert len(i.query_ascii_values("TRAC? TRACE1")) == 501
    assert i.query("SYST:ERR?").startswith("0,")
    i.close()


def test_unknown_messages_are_refused_and_the_session_goes_on(client: HislipLine) -> None:
    client.sync.say(26, 0, 0, b"descriptors")
    assert client.sync.on_input()[:2] == (w.ERROR, 1)
    client.sync.say(200, 0, 0, b"vendor")
    assert client.sync.on_input()[:2] == (w.ERROR, 3)
    client.side.say(w.DATA_END, 0, w.FIRST_ID, b"*IDN?")
    assert client.side.on_input()[:2] == (w.ERROR, 1), "data has no business on this channel"
    client.side.say(w.REMOTE, 9)
    assert client.side.on_input()[:2] == (w.ERROR, 2)
    client.side.say(w.LOCK, 2)
    assert client.side.on_input()[:2] == (w.ERROR, 2)
    client.side.say(w.SIZE, 0, 0, b"12")
    assert client.side.on_input()[:2] == (w.ERROR, 0)
    for control in range(7):
        client.side.say(w.REMOTE, control, client.last_id)
        assert client.side.on_input()[:2] == (w.REMOTE_DONE, 0)
    client.sync.say(w.ERROR, 0, 0, b"the client complains")
    assert client.ask("*IDN?") == IDENTITY


@pytest.mark.parametrize(
    "garbage",
    [b"GET / HTTP/1.1\r\n\r\n", b"*IDN?\n", bytes(64), struct.pack("!2sBBIQ", b"HS", 7, 0, 0, 2**64 - 1)],
)
def test_garbage_ends_its_own_session_only(analyzer: AnalyzerThread, client: HislipLine, garbage: bytes) -> None:
    with HislipLine(analyzer.hislip_port) as other:
        other.sync.write(garbage)
        assert other.sync.on_input()[:2] == (w.FATAL, 1)
        assert other.sync.is_closed()
        assert other.side.is_closed()
    with Channel(analyzer.hislip_port) as fresh:
        fresh.write(garbage)
        assert fresh.on_input().kind == w.FATAL
        assert fresh.is_closed()
    assert client.ask("*IDN?") == IDENTITY


def test_wrong_beginnings_are_fatal(analyzer: AnalyzerThread, client: HislipLine) -> None:
    def fate(kind: int, parameter: int = 0, payload: bytes = b"") -> int:
        with Channel(analyzer.hislip_port) as wire:
            wire.say(kind, 0, parameter, payload)
            heard = wire.on_input()
            assert heard.kind == w.FATAL
            assert wire.is_closed()
            return heard.control

    assert fate(w.DATA_END, w.FIRST_ID, b"*IDN?") == 3
    assert fate(w.ASYNC_INITIALIZE, 54321) == 3
    assert fate(w.ASYNC_INITIALIZE, client.opened.parameter & 0xFFFF) == 3, "the session has its channel already"
    assert fate(w.INITIALIZE, 0x0100 << 16, b"hislip7") == 3
    with Channel(analyzer.hislip_port) as half:
        half.say(w.INITIALIZE, 0, 0x0100 << 16, b"hislip0")
        assert half.on_input().kind == w.INITIALIZED
        half.say(w.DATA_END, 0, w.FIRST_ID, b"*IDN?")
        assert half.on_input()[:2] == (w.FATAL, 2)
    client.sync.say(w.INITIALIZE, 0, 0x0100 << 16, b"hislip0")
    assert client.sync.on_input()[:2] == (w.FATAL, 3)
    assert client.side.is_closed()


def test_fatal_error_of_the_client_closes_both_channels(client: HislipLine) -> None:
    client.side.say(w.FATAL, 0, 0, b"enough")
    assert client.side.is_closed()
    assert client.sync.is_closed()


@pytest.mark.parametrize("fault", [LineFault.RESET, LineFault.CLOSE])
def test_a_fault_that_ends_the_line_ends_both_channels(
    analyzer: AnalyzerThread, client: HislipLine, fault: LineFault
) -> None:
    analyzer.faults.arm(fault)
    client.write(b"*IDN?")
    assert client.sync.is_closed()
    assert client.side.is_closed()


def test_a_stale_answer_has_the_old_identifier(analyzer: AnalyzerThread, client: HislipLine) -> None:
    analyzer.faults.arm(LineFault.STALE)
    first_id = client.write(b"*ESE?")
    while analyzer.faults.remaining:
        time.sleep(0.001)
    assert client.sync.hears_nothing(0.05)
    second_id = client.write(b"*IDN?")
    heard = [client.sync.on_input() for _ in range(3)]
    assert [(message.kind, message.parameter) for message in heard] == [
        (w.INTERRUPTED, second_id),
        (w.DATA_END, first_id),
        (w.DATA_END, second_id),
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
    parameter = int(rng.choice([0, 1, w.FIRST_ID, 2**32 - 1]))
    chosen = payload[int(rng.integers(len(payload)))]
    length = len(chosen) if rng.random() < 0.95 else int(rng.integers(0, 2**40))
    return struct.pack("!2sBBIQ", b"HS", kind, int(rng.integers(0, 3)), parameter, length) + chosen


def test_any_messages_in_any_order_leave_the_instrument_to_others(analyzer: AnalyzerThread, client: HislipLine) -> None:
    seed = 20261122
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    for _ in range(150):
        with HislipLine(analyzer.hislip_port) as wild:
            try:
                for _ in range(int(rng.integers(1, 30))):
                    wire = wild.sync if rng.random() < 0.6 else wild.side
                    wire.write(random_message(rng))
            except (BrokenPipeError, ConnectionResetError):
                pass  # a fatal error has ended it
    client.write(b"ABOR;*CLS;:INIT:CONT OFF")
    assert client.ask("*IDN?") == IDENTITY
    client.side.say(w.LOCK_INFO)
    heard = client.side.on_input()
    while heard.kind == w.SERVICE:
        heard = client.side.on_input()
    assert heard[:3] == (w.LOCK_TOLD, 0, 0), "those who left hold no lock"


def test_a_client_that_reads_nothing_is_cleared_or_leaves(analyzer: AnalyzerThread, client: HislipLine) -> None:
    with HislipLine(analyzer.hislip_port) as deaf:
        deaf.write(SETUP + b";:SWE:POIN 100001;:INIT")
        deaf.write(b";".join([b"TRAC? TRACE1"] * 30))  # 12 MB: more than buffers on the way hold
        for _ in range(200):
            deaf.write(b"*CLS")
        assert client.ask("*IDN?") == IDENTITY
        deaf.clear()
        assert deaf.ask("*ESE?") == "0"
        deaf.write(b";".join([b"TRAC? TRACE1"] * 30))
        deaf.write(b"*CLS")
    assert client.ask("*OPC?") == "1"
