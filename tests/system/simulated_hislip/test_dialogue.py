"""HiSLIP over real sockets: dialogue, clear and locks, and VISA libraries."""

import socket
import struct
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from analyzer_thread import AnalyzerThread
from hislip_client import (
    ASYNC_INTERRUPTED,
    CLEAR,
    CLEAR_ACKNOWLEDGED,
    CLEAR_COMPLETE,
    CLEAR_DONE,
    DATA,
    DATA_END,
    FATAL,
    FIRST_ID,
    IDENTITY,
    INITIALIZE,
    INTERRUPTED,
    LOCK,
    LOCK_INFO,
    LOCK_TOLD,
    SERVICE,
    SETUP,
    SIZE,
    SIZE_TOLD,
    TRIGGER,
    Client,
    Heard,
    Held,
    Wire,
)

from analyzer_sim.dialects.rs import RS

pytestmark = pytest.mark.system


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


def test_a_trace_is_cut_to_what_the_client_takes(client: Client) -> None:
    client.side.say(SIZE, 0, 0, struct.pack("!Q", 1016))
    reported = client.side.on_input()
    assert reported.kind == SIZE_TOLD
    assert struct.unpack("!Q", reported.payload)[0] >= 1 << 20
    client.write(SETUP + b";:INIT")
    client.write(b"TRAC? TRACE1")
    block = b""
    kinds = []
    while not kinds or kinds[-1] == DATA:
        heard = client.sync.on_input()
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
    first = client.sync.on_input()
    assert first.payload == IDENTITY + b"\n"
    second_id = client.write(b"*OPC?")  # RMT-delivered is not set: the client says it never read the answer
    assert client.sync.on_input() == Heard(INTERRUPTED, 0, second_id, b"")
    assert client.side.on_input() == Heard(ASYNC_INTERRUPTED, 0, second_id, b"")
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


# status and service requests
def test_status_byte_tells_that_an_answer_waits(client: Client) -> None:
    client.write(b"*CLS;*ESE?")
    heard = client.sync.on_input()
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
    heard = client.side.on_input()
    assert (heard.kind, heard.control & 0x60, heard.parameter) == (SERVICE, 0x60, 0)
    assert client.status() & 0x60 == 0x60
    assert client.status() & 0x60 == 0x20, "the request is spent by the first poll"
    assert client.side.hears_nothing(0.05)
    assert client.ask(b"*STB?") == b"96", "*STB? shows the summary, which stays"


def test_an_error_of_another_session_requests_service_of_all(analyzer: AnalyzerThread, client: Client) -> None:
    client.write(b"*CLS;*SRE 4")
    with Client(analyzer.hislip_port) as other:
        other.write(b"NONE")
        assert other.side.on_input().kind == SERVICE
    heard = client.side.on_input()
    assert (heard.kind, heard.control & 0x44) == (SERVICE, 0x44)


def test_device_clear_in_mid_sweep(held: Held, client: Client) -> None:
    held.allowed.clear()
    client.write(SETUP + b";:INIT")
    client.write(b"*OPC?")
    client.write(b"*IDN", DATA)
    held.await_sweep()
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
    assert client.side.on_input().kind == CLEAR_ACKNOWLEDGED
    client.write(b"*ESE 77;*IDN?")
    client.sync.say(CLEAR_COMPLETE)
    heard = [client.sync.on_input()]
    while heard[-1].kind != CLEAR_DONE:
        heard.append(client.sync.on_input())
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
        assert client.side.on_input()[:3] == (LOCK_TOLD, 1, 2)
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
        line.settimeout(120.0)
        assert line.recv(10) == b"1\n"


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
        assert wire.on_input()[:2] == (FATAL, 4)
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
    assert np.max(np.abs(y - a)) < 1e-4
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
