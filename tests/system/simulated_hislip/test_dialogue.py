"""HiSLIP: questions, answers, interruption, status and service requests."""

import socket
import struct

import numpy as np
import pytest
from analyzer_thread import AnalyzerThread
from hislip_client import (
    ASYNC_INTERRUPTED,
    DATA,
    DATA_END,
    FIRST_ID,
    IDENTITY,
    INTERRUPTED,
    SERVICE,
    SETUP,
    SIZE,
    SIZE_TOLD,
    Client,
    Heard,
    Held,
)

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
