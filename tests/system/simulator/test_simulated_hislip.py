"""HiSLIP over real sockets: dialogue, clear, locks, VISA libraries, what a client does wrong, faults of the line."""

import socket
import struct
import time
from collections.abc import Iterator

import numpy as np
import pytest
from analyzer_thread import AnalyzerThread, start_in_thread
from hislip_client import (
    ASYNC_INITIALIZE,
    ASYNC_INTERRUPTED,
    CLEAR,
    CLEAR_ACKNOWLEDGED,
    CLEAR_COMPLETE,
    CLEAR_DONE,
    DATA_END,
    ERROR,
    FATAL,
    FIRST_ID,
    IDENTITY,
    INITIALIZE,
    INITIALIZED,
    INTERRUPTED,
    LOCK,
    LOCK_INFO,
    LOCK_TOLD,
    REMOTE,
    REMOTE_DONE,
    SERVICE,
    SETUP,
    SIZE,
    Client,
    Heard,
    Held,
    Wire,
)

from analyzer_sim.dialects.rs import RS
from analyzer_sim.lines.line_faults import LineFault

pytestmark = pytest.mark.system


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
    with socket.create_connection(("127.0.0.1", analyzer.port), timeout=120.0) as line:
        line.sendall(b"SWE:POIN?;:SYST:ERR?\n")
        assert line.recv(200).startswith(b"501;-113")


def test_messages_are_executed_strictly_in_order(client: Client) -> None:
    for number in range(300):
        client.write(b"*ESE %d" % (number % 100))
    assert client.ask(b"*ESE?;:SYST:ERR:COUN?") == b"99;0"


def test_an_answer_not_yet_given_is_never_given_once_interrupted(held: Held, client: Client) -> None:
    held.allowed.clear()
    client.write(SETUP)
    client.write(b"INIT;*OPC?")
    second_id = client.write(b"*ESE?")
    assert client.sync.hears_nothing()
    held.allowed.set()
    assert client.sync.on_input() == Heard(INTERRUPTED, 0, second_id, b"")
    assert client.side.on_input().kind == ASYNC_INTERRUPTED
    assert client.read() == b"0"


def test_two_questions_in_one_message_interrupt_each_other(client: Client) -> None:
    assert client.ask(b"*ESE?\n*OPC?\n") == b"1"
    assert client.ask(b"SYST:ERR?").startswith(b"-410")


def test_status_query_tells_delivery_too(client: Client) -> None:
    assert client.ask(b"*ESE?") == b"0"
    assert client.status() & 16 == 0
    client.delivered = 0  # as pyvisa-py does: it says so once, in the status query
    assert client.ask(b"*OPC?;:SYST:ERR:COUN?") == b"1;0"


def test_status_is_told_while_a_sweep_holds_the_session(held: Held, client: Client) -> None:
    held.allowed.clear()
    client.write(SETUP + b";*ESE 1;:INIT;*OPC")
    client.write(b"*WAI;*ESE?")
    assert client.status() & 32 == 0
    held.allowed.set()
    assert client.read() == b"1"
    assert client.status() & 32 == 32


def test_an_error_of_another_session_requests_service_of_all(analyzer: AnalyzerThread, client: Client) -> None:
    client.write(b"*CLS;*SRE 4")
    with Client(analyzer.hislip_port) as other:
        other.write(b"NONE")
        assert other.side.on_input().kind == SERVICE
    heard = client.side.on_input()
    assert (heard.kind, heard.control & 0x44) == (SERVICE, 0x44)


def test_device_clear_again_and_again(client: Client) -> None:
    for _ in range(20):
        client.write(b"*IDN?")
        client.clear()
    assert client.ask(b"*OPC?") == b"1"


def test_exclusive_lock_holds_the_others_back_until_it_is_given_back(analyzer: AnalyzerThread, client: Client) -> None:
    assert client.lock() == 1
    with Client(analyzer.hislip_port) as other:
        assert other.lock() == 0, "no patience, no lock"
        other.write(b"*ESE 9;*ESE?")
        assert other.sync.hears_nothing()
        assert other.status() & 16 == 0, "status is told to everybody"
        other.side.say(LOCK_INFO)
        assert other.side.on_input()[:3] == (LOCK_TOLD, 1, 1)
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
        assert time.monotonic() - began_s > 0.14
        other.side.say(LOCK, 1, 120_000)
        assert other.side.hears_nothing(0.05)
        assert client.unlock() == 1
        assert other.lock_answer() == 1


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
        line.settimeout(120.0)
        assert line.recv(10) == b"1\n"


def test_the_sixty_fifth_session_is_refused(analyzer: AnalyzerThread) -> None:
    clients = [Client(analyzer.hislip_port) for _ in range(64)]
    with Wire(analyzer.hislip_port) as wire:
        wire.say(INITIALIZE, 0, 0x0100 << 16, b"hislip0")
        assert wire.on_input()[:2] == (FATAL, 4)
    assert all(client.ask(b"*OPC?") == b"1" for client in clients)
    for client in clients:
        client.__exit__()


@pytest.mark.parametrize("resource", ["hislip0,{0.hislip_port}::INSTR", "{0.port}::SOCKET"], ids=["HiSLIP", "socket"])
def test_pyvisa_reads_the_same_trace_in_both_formats(analyzer: AnalyzerThread, resource: str) -> None:
    # the first script of section 8 of the analyzer specification, word for word
    import pyvisa

    manager = pyvisa.ResourceManager("@py")
    i = manager.open_resource(
        "TCPIP::127.0.0.1::" + resource.format(analyzer),
        read_termination="\n",
        write_termination="\n",
        timeout=120_000,
        chunk_size=1 << 20,
    )
    i.write("*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20e6;:BAND 30 KHZ;:SWE:POIN 2001;TIME 0.2;:DET RMS")
    assert i.query("INIT;*OPC?").strip() == "1"
    i.write("FORM REAL,32")
    y = i.query_binary_values("TRAC? TRACE1", "f", is_big_endian=False, container=np.array)
    i.write("FORM ASC")
    a = np.array(i.query_ascii_values("TRAC:DATA? TRACE1"))
    assert len(y) == len(a) == 2001
    assert np.max(np.abs(y - a)) < 1e-4  # the specification's figure: seven digits against 24 bits
    assert i.query("SYST:ERR?").startswith("0,")
    i.close()


def test_pyvisa_times_out_polls_clears_and_goes_on(held: Held, analyzer: AnalyzerThread) -> None:
    import pyvisa

    i = pyvisa.ResourceManager("@py").open_resource(
        f"TCPIP::127.0.0.1::hislip0,{analyzer.hislip_port}::INSTR",
        read_termination="\n",
        write_termination="\n",
        timeout=120_000,
    )
    held.allowed.clear()
    i.write("*RST;*CLS;*ESE 1;:INIT:CONT OFF;:SWE:POIN 501;:INIT;*OPC")
    assert i.read_stb() & 32 == 0
    i.timeout = 200
    with pytest.raises(pyvisa.VisaIOError):
        i.query("*OPC?")
    i.timeout = 120_000
    i.clear()
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
        i = manager.open_resource(resource, read_termination="\n", write_termination="\n", timeout=120_000)
        i.write("*RST;*CLS;:INIT:CONT OFF;:SWE:POIN 501;:INIT")
        i.timeout = 100
        with pytest.raises(pyvisa.VisaIOError):
            i.query("*OPC?")
        held.allowed.set()
        i.timeout = 120_000
        answers.append(i.query("*IDN?"))
        i.close()
    assert answers == [RS.identity, "1"]


def test_unknown_messages_are_refused_and_the_session_goes_on(client: Client) -> None:
    client.sync.say(26, 0, 0, b"descriptors")
    assert client.sync.on_input()[:2] == (ERROR, 1)
    client.sync.say(200, 0, 0, b"vendor")
    assert client.sync.on_input()[:2] == (ERROR, 3)
    client.side.say(DATA_END, 0, FIRST_ID, b"*IDN?")
    assert client.side.on_input()[:2] == (ERROR, 1), "data has no business on this channel"
    client.side.say(REMOTE, 9)
    assert client.side.on_input()[:2] == (ERROR, 2)
    client.side.say(LOCK, 2)
    assert client.side.on_input()[:2] == (ERROR, 2)
    client.side.say(SIZE, 0, 0, b"12")
    assert client.side.on_input()[:2] == (ERROR, 0)
    for control in range(7):
        client.side.say(REMOTE, control, client.last_id)
        assert client.side.on_input()[:2] == (REMOTE_DONE, 0)
    client.sync.say(ERROR, 0, 0, b"the client complains")
    assert client.ask(b"*IDN?") == IDENTITY


@pytest.mark.parametrize(
    "garbage",
    [b"GET / HTTP/1.1\r\n\r\n", b"*IDN?\n", bytes(64), struct.pack("!2sBBIQ", b"HS", 7, 0, 0, 2**64 - 1)],
)
def test_garbage_ends_its_own_session_only(analyzer: AnalyzerThread, client: Client, garbage: bytes) -> None:
    with Client(analyzer.hislip_port) as other:
        other.sync.line.sendall(garbage)
        assert other.sync.on_input()[:2] == (FATAL, 1)
        assert other.sync.is_closed()
        assert other.side.is_closed()
    with Wire(analyzer.hislip_port) as fresh:
        fresh.line.sendall(garbage)
        assert fresh.on_input().kind == FATAL
        assert fresh.is_closed()
    assert client.ask(b"*IDN?") == IDENTITY


def test_wrong_beginnings_are_fatal(analyzer: AnalyzerThread, client: Client) -> None:
    def fate(kind: int, parameter: int = 0, payload: bytes = b"") -> int:
        with Wire(analyzer.hislip_port) as wire:
            wire.say(kind, 0, parameter, payload)
            heard = wire.on_input()
            assert heard.kind == FATAL
            assert wire.is_closed()
            return heard.control

    assert fate(DATA_END, FIRST_ID, b"*IDN?") == 3
    assert fate(ASYNC_INITIALIZE, 54321) == 3
    assert fate(ASYNC_INITIALIZE, client.opened.parameter & 0xFFFF) == 3, "the session has its channel already"
    assert fate(INITIALIZE, 0x0100 << 16, b"hislip7") == 3
    with Wire(analyzer.hislip_port) as half:
        half.say(INITIALIZE, 0, 0x0100 << 16, b"hislip0")
        assert half.on_input().kind == INITIALIZED
        half.say(DATA_END, 0, FIRST_ID, b"*IDN?")
        assert half.on_input()[:2] == (FATAL, 2)
    client.sync.say(INITIALIZE, 0, 0x0100 << 16, b"hislip0")
    assert client.sync.on_input()[:2] == (FATAL, 3)
    assert client.side.is_closed()


def test_a_client_that_leaves_in_mid_sweep_leaves_the_instrument_to_others(
    held: Held, analyzer: AnalyzerThread
) -> None:
    held.allowed.clear()
    with Client(analyzer.hislip_port) as leaving:
        leaving.write(SETUP)
        leaving.write(b"INIT;*OPC?")
        held.await_sweep()
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
    while analyzer.faults.remaining:
        time.sleep(0.001)
    assert client.sync.hears_nothing(0.05)
    second_id = client.write(b"*IDN?")
    heard = [client.sync.on_input() for _ in range(3)]
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
    heard = client.side.on_input()
    while heard.kind == SERVICE:
        heard = client.side.on_input()
    assert heard[:3] == (LOCK_TOLD, 0, 0), "those who left hold no lock"


def test_a_client_that_reads_nothing_is_cleared_or_leaves(analyzer: AnalyzerThread, client: Client) -> None:
    with Client(analyzer.hislip_port) as deaf:
        deaf.write(SETUP + b";:SWE:POIN 100001;:INIT")
        deaf.write(b";".join([b"TRAC? TRACE1"] * 30))  # 12 MB: more than buffers on the way hold
        for _ in range(200):
            deaf.write(b"*CLS")
        assert client.ask(b"*IDN?") == IDENTITY
        deaf.side.say(CLEAR)
        while deaf.side.on_input().kind != CLEAR_ACKNOWLEDGED:
            pass
        deaf.sync.say(CLEAR_COMPLETE)
        while deaf.sync.on_input().kind != CLEAR_DONE:
            pass
        deaf.next_id, deaf.delivered = FIRST_ID, 0
        assert deaf.ask(b"*ESE?") == b"0"
        deaf.write(b";".join([b"TRAC? TRACE1"] * 30))
        deaf.write(b"*CLS")
    assert client.ask(b"*OPC?") == b"1"
