"""Rules that only a line can show: blocks, stale answers, interrupted queries, requests for service."""

import struct
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import wire_lines as w
from analyzer_thread import AnalyzerThread, start_in_thread
from scpi_bench import block_payload, standing_instrument
from wire_lines import HislipLine, RawLine

from analyzer_sim.dialects.dialects import DIALECTS

pytestmark = pytest.mark.system

SETUP = "*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ;:BAND 100 KHZ;:SWE:TIME 0.2"


@pytest.fixture
def gate() -> dict[str, bool]:
    """Return whether sweeps may complete."""
    return {"is_open": True}


@pytest.fixture
def analyzer(name: str, gate: dict[str, bool]) -> Iterator[AnalyzerThread]:
    dialect = DIALECTS[name]
    instrument = standing_instrument(dialect, may_advance=lambda: gate["is_open"])
    with start_in_thread(instrument, dialect=dialect, hislip_port=0) as handle:
        yield handle


@pytest.fixture
def raw(analyzer: AnalyzerThread) -> Iterator[RawLine]:
    with RawLine(analyzer.port) as line:
        yield line


@pytest.fixture
def hislip(analyzer: AnalyzerThread) -> Iterator[HislipLine]:
    with HislipLine(analyzer.hislip_port or 0) as line:
        yield line


@pytest.fixture(params=["socket", "HiSLIP"])
def line(request: pytest.FixtureRequest, raw: RawLine, hislip: HislipLine) -> RawLine | HislipLine:
    """Each of the two transports."""
    return raw if request.param == "socket" else hislip


def trace_bytes(line, facts):
    """Ask for the trace in 32 bit floats; return what the block holds."""
    line.write(facts.trace_query.encode() + b"\n")
    if isinstance(line, HislipLine):
        data = line.read()
    else:
        head = line.received(2)
        size = line.received(int(head[1:]))
        data = head + size + line.received(int(size) + 1)
    return block_payload(data)


# both transports


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


def test_ten_sessions_of_both_kinds_get_their_own_answers(analyzer, facts):
    def talk(number: int) -> int:
        with RawLine(analyzer.port) if number % 2 else HislipLine(analyzer.hislip_port or 0) as line:
            return sum(line.ask(f"*OPC?;:FREQ:SPAN? MIN;*IDN? {turn};*TST?").startswith("1;") for turn in range(20))

    with ThreadPoolExecutor(10) as pool:
        assert list(pool.map(talk, range(10))) == [20] * 10


# the raw socket


def test_socket_keeps_answers_nobody_read(raw, facts):
    raw.write(b"*ESE 7;*ESE?\n*OPC?\n*SRE?\n")
    assert raw.read_until(b"0\n") == b"7\n1\n0\n"
    assert raw.ask("SYST:ERR?") == facts.no_error, "there is no -410 on a raw socket"


def test_socket_says_nothing_when_there_is_nothing_to_say(raw, facts):
    assert raw.hears_nothing()
    assert raw.ask("SYST:ERR?") == facts.no_error, "there is no -420 on a raw socket"


# HiSLIP


def test_answer_is_cut_to_the_size_the_client_takes(hislip, facts):
    hislip.side.say(w.SIZE, 0, 0, struct.pack("!Q", 256))
    assert hislip.side.on_input().kind == w.SIZE_TOLD
    hislip.write(f"{SETUP};:FORM ASC;:INIT;*WAI\n".encode())
    sent = hislip.write(facts.trace_query.encode() + b"\n")
    packets = [hislip.sync.on_input()]
    while packets[-1].kind != w.DATA_END:
        packets.append(hislip.sync.on_input())
    assert len(packets) > 20
    assert {packet.kind for packet in packets[:-1]} == {w.DATA}
    assert {packet.parameter for packet in packets} == {sent}
    assert max(len(packet.payload) for packet in packets) <= 256
    assert packets[-1].payload.endswith(b"\n")


def test_new_message_while_an_answer_is_unread_interrupts(hislip):
    hislip.write(b"*IDN?\n")
    assert hislip.sync.on_input().kind == w.DATA_END
    # the answer came, but the client's program has not read it: its next message says so
    second = hislip.write(b"*OPC?\n")
    interrupted = hislip.sync.on_input()
    assert (interrupted.kind, interrupted.parameter) == (w.INTERRUPTED, second)
    assert hislip.side.on_input().kind == w.ASYNC_INTERRUPTED
    assert hislip.read() == b"1\n"
    assert hislip.ask("SYST:ERR?").startswith("-410,")
    assert int(hislip.ask("*ESR?")) & 4


def test_message_available_while_an_answer_is_unread(hislip):
    assert hislip.status() & 16 == 0
    hislip.write(b"*IDN?\n")
    assert hislip.sync.on_input().kind == w.DATA_END
    assert hislip.status() & 16
    hislip.delivered = 1
    assert hislip.status() & 16 == 0


def test_service_is_requested_once_for_each_reason(hislip, gate, facts):
    hislip.write(f"{SETUP};:{facts.few_points};*ESE 1;*SRE 32\n".encode())
    gate["is_open"] = False
    hislip.write(b"INIT;*OPC\n")
    assert hislip.status() & 0x60 == 0
    gate["is_open"] = True
    assert hislip.side.on_input().kind == w.SERVICE
    assert hislip.status() & 0x60 == 0x60
    assert hislip.status() & 0x60 == 0x20, "the poll has taken the request, the reason stands"


def test_trigger_starts_a_sweep(hislip, facts):
    hislip.write(f"{SETUP};:{facts.few_points};:FORM ASC\n".encode())
    hislip.write(b"", w.TRIGGER)
    assert hislip.ask(f"{facts.trace_query};*OPC?").count(",") >= facts.points - 1
    assert hislip.ask("SYST:ERR?") == facts.no_error
