"""Rules that only a line can show: ends of messages, stale answers, interrupted queries, requests for service."""

import struct
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import numpy as np
import pytest
import wire_lines as w
from analyzer_thread import AnalyzerThread, start_in_thread
from scpi_bench import standing_instrument
from wire_lines import HislipLine, RawLine

from analyzer_sim.dialects.dialects import DIALECTS

pytestmark = pytest.mark.system

SETUP = "*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ;:BAND 100 KHZ;:SWE:TIME 0.2"


@pytest.fixture
def gate() -> dict[str, bool]:
    """Whether sweeps may complete."""
    return {"is_open": True}


@pytest.fixture
def analyzer(name: str, gate: dict[str, bool]) -> Iterator[AnalyzerThread]:
    dialect = DIALECTS[name]
    instrument = standing_instrument(dialect, may_advance=lambda: gate["is_open"])
    with start_in_thread(instrument, dialect=dialect, hislip_port=0) as handle:
        yield handle


@pytest.fixture
def raw(analyzer: AnalyzerThread) -> Iterator[RawLine]:
    with closing(RawLine(analyzer.port)) as line:
        yield line


@pytest.fixture
def hislip(analyzer: AnalyzerThread) -> Iterator[HislipLine]:
    with closing(HislipLine(analyzer.hislip_port or 0)) as line:
        yield line


@pytest.fixture(params=["socket", "HiSLIP"])
def line(request: pytest.FixtureRequest, analyzer: AnalyzerThread) -> Iterator[RawLine | HislipLine]:
    """Each of the two transports."""
    made = RawLine(analyzer.port) if request.param == "socket" else HislipLine(analyzer.hislip_port or 0)
    with closing(made):
        yield made


def trace_bytes(line, facts):
    """Ask for the trace in 32 bit floats; return what the block holds."""
    line.write(facts.trace_query.encode() + b"\n")
    if isinstance(line, HislipLine):
        data = line.read()[1]
    else:
        head = w.received(line.socket, 2)
        size = w.received(line.socket, int(head[1:]))
        data = head + size + w.received(line.socket, int(size) + 1)
    digits = int(data[1:2])
    assert data[:1] == b"#"
    assert data[-1:] == b"\n"
    assert int(data[2 : 2 + digits]) == len(data) - 3 - digits
    return data[2 + digits : -1]


# both transports


@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
def test_either_end_of_a_message_is_accepted(line, facts, end):
    line.write(b"*ESE 5" + end)
    assert line.ask("*ESE?") == "5"
    assert line.ask("SYST:ERR?") == facts.no_error


def test_blocks_hold_line_feeds_and_come_whole(line, facts):
    line.write(f"{SETUP};:{facts.power_detector};:{facts.real32};:INIT;*WAI\n".encode())
    dtype = ">f4" if facts.is_big_endian else "<f4"
    for _ in range(200):
        payload = trace_bytes(line, facts)
        assert np.all(np.isfinite(np.frombuffer(payload, dtype)))
        if b"\n" in payload:
            break
        line.write(b"INIT;*WAI\n")
    assert b"\n" in payload
    assert line.ask("SYST:ERR?") == facts.no_error


def test_message_of_200_kib_is_heard(line):
    answer = line.ask("*ESE?;" * 32_000 + "*SRE?")
    assert answer == "0;" * 32_000 + "0"


def test_wrong_query_never_disconnects(line, facts):
    for wrong in ("NONE?", "FREQ:CENT? 1 S", "\x00", "*IDN? 5", "#", "'", '"'):
        line.write(wrong.encode() + b"\n")
        line.write(b"'\n" if wrong == "'" else b'"\n' if wrong == '"' else b"\n")
    assert line.ask("*OPC?") == "1"
    line.write(b"*CLS\n")
    assert line.ask("SYST:ERR?") == facts.no_error


def test_opc_query_waits_on_the_line(line, gate, facts):
    line.write(f"{SETUP};:{facts.few_points}\n".encode())
    gate["is_open"] = False
    line.write(b"INIT;*OPC?\n")
    reading = line.socket if isinstance(line, RawLine) else line.synchronous
    reading.settimeout(0.2)
    with pytest.raises(TimeoutError):
        reading.recv(1)
    gate["is_open"] = True
    reading.settimeout(120.0)
    answer = line.read_until(b"\n") if isinstance(line, RawLine) else line.read()[1]
    assert answer == b"1\n"


def test_ten_sessions_of_both_kinds_get_their_own_answers(analyzer, facts):
    def talk(number: int) -> int:
        line = RawLine(analyzer.port) if number % 2 else HislipLine(analyzer.hislip_port or 0)
        with closing(line):
            return sum(line.ask(f"*OPC?;:FREQ:SPAN? MIN;*IDN? {turn};*TST?").startswith("1;") for turn in range(20))

    with ThreadPoolExecutor(10) as pool:
        assert list(pool.map(talk, range(10))) == [20] * 10


def test_settings_are_the_instruments_and_every_session_sees_them(raw, hislip):
    raw.write(b"FREQ:CENT 1.2 GHZ\n")
    assert raw.ask("*OPC?") == "1"
    assert hislip.ask("FREQ:CENT?") == "1200000000"


# the raw socket


def test_socket_keeps_answers_nobody_read(raw, facts):
    raw.write(b"*ESE 7;*ESE?\n*OPC?\n*SRE?\n")
    assert raw.read_until(b"0\n") == b"7\n1\n0\n"
    assert raw.ask("SYST:ERR?") == facts.no_error, "there is no -410 on a raw socket"


def test_socket_says_nothing_when_there_is_nothing_to_say(raw, facts):
    raw.socket.settimeout(0.1)
    with pytest.raises(TimeoutError):
        raw.read_until(b"\n")
    raw.socket.settimeout(120.0)
    assert raw.ask("SYST:ERR?") == facts.no_error, "there is no -420 on a raw socket"


# HiSLIP


def test_answer_carries_the_identifier_of_its_question(hislip):
    for _ in range(3):
        sent = hislip.write(b"*IDN?\n")
        assert hislip.read()[0] == sent


def test_answer_is_cut_to_the_size_the_client_takes(analyzer, facts):
    with closing(HislipLine(analyzer.hislip_port or 0, client_bytes=256)) as line:
        line.write(f"{SETUP};:FORM ASC;:INIT;*WAI\n".encode())
        sent = line.write(facts.trace_query.encode() + b"\n")
        packets = [line.consume()]
        while packets[-1].kind != w.DATA_END:
            packets.append(line.consume())
        assert len(packets) > 20
        assert {packet.kind for packet in packets[:-1]} == {w.DATA}
        assert {packet.parameter for packet in packets} == {sent}
        assert max(len(packet.payload) for packet in packets) <= 256
        assert packets[-1].payload.endswith(b"\n")


def test_message_in_pieces_is_one_message(hislip):
    for chunk in (b"*ES", b"E 9;", b"*ESE"):
        hislip.put(w.DATA, 0, hislip.message_id, chunk)
    hislip.write(b"?\n")
    assert hislip.read()[1] == b"9\n"


def test_new_message_while_an_answer_is_unread_interrupts(hislip):
    hislip.write(b"*IDN?\n")
    assert hislip.consume().kind == w.DATA_END
    # the answer came, but the client's program has not read it: its next message says so
    second = hislip.write(b"*OPC?\n")
    interrupted = hislip.consume()
    assert (interrupted.kind, interrupted.parameter) == (w.INTERRUPTED, second)
    assert hislip.on_asynchronous().kind == w.ASYNC_INTERRUPTED
    assert hislip.read() == (second, b"1\n")
    assert hislip.ask("SYST:ERR?").startswith("-410,")
    assert int(hislip.ask("*ESR?")) & 4


def test_answer_that_was_read_interrupts_nothing(hislip, facts):
    for _ in range(3):
        assert hislip.ask("*OPC?") == "1"
    assert hislip.ask("SYST:ERR?") == facts.no_error


def test_message_available_while_an_answer_is_unread(hislip):
    assert hislip.status() & 16 == 0
    hislip.write(b"*IDN?\n")
    assert hislip.consume().kind == w.DATA_END
    assert hislip.status() & 16
    hislip.is_delivered = True
    assert hislip.status() & 16 == 0


def test_service_is_requested_once_for_each_reason(hislip, gate, facts):
    hislip.write(f"{SETUP};:{facts.few_points};*ESE 1;*SRE 32\n".encode())
    gate["is_open"] = False
    hislip.write(b"INIT;*OPC\n")
    assert hislip.status() & 0x60 == 0
    gate["is_open"] = True
    assert hislip.on_asynchronous().kind == w.SERVICE_REQUEST
    assert hislip.status() & 0x60 == 0x60
    assert hislip.status() & 0x60 == 0x20, "the poll has taken the request, the reason stands"


def test_device_clear_ends_what_hangs_and_keeps_the_settings(hislip, analyzer, gate, facts):
    assert hislip.ask(f"{SETUP};:{facts.few_points};*OPC?") == "1"
    gate["is_open"] = False
    hislip.write(b"INIT;*OPC?\n")
    while not analyzer.instrument.is_pending:  # a clear that overtakes the message would drop it unheard
        time.sleep(0.001)
    hislip.clear()
    assert hislip.ask("FREQ:CENT?") == "1017000000"
    gate["is_open"] = True
    assert hislip.ask("*OPC?") == "1"
    assert hislip.ask("SYST:ERR?") == facts.no_error


def test_device_clear_empties_input_and_output(hislip, facts):
    hislip.put(w.DATA, 0, hislip.message_id, b"FREQ:CENT ")
    hislip.clear()
    hislip.write(b"*IDN?\n")
    hislip.clear()
    assert hislip.ask("*OPC?") == "1"
    assert hislip.ask("SYST:ERR?") == facts.no_error


def test_trigger_starts_a_sweep(hislip, analyzer, facts):
    hislip.write(f"{SETUP};:{facts.few_points}\n".encode())
    hislip.put(w.TRIGGER, 0, hislip.message_id)
    hislip.message_id += 2
    assert hislip.ask("*OPC?") == "1"
    assert hislip.ask("SYST:ERR?") == facts.no_error


def test_unknown_type_is_an_error_and_no_end(hislip):
    hislip.put(99, 0, 0, b"nonsense")
    refused = hislip.consume()
    assert (refused.kind, refused.control) == (3, 1)
    assert hislip.ask("*OPC?") == "1"


def test_wrong_prologue_ends_the_session(analyzer):
    with closing(w.connected(analyzer.hislip_port)) as line:
        line.sendall(b"XX" + bytes(14))
        prologue, kind, *_, length = struct.unpack("!2sBBIQ", w.received(line, 16))
        assert (prologue, kind) == (b"HS", 2)
        w.received(line, length)
        assert line.recv(1) == b""
