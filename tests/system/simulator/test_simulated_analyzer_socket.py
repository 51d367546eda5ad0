"""The simulated analyzer on a real socket: garbage, faults of the line, clients that leave."""

import socket
import struct
import threading
import time
from collections.abc import Iterator

import pytest
from analyzer_thread import AnalyzerThread, start_in_thread
from standing_source import StandingSource
from wire_lines import RawLine

from analyzer_sim.dialects.rs import IDENTITY
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import TracePainter
from analyzer_sim.lines.line_faults import GARBAGE_BYTES, LineFault

pytestmark = pytest.mark.system

SETUP = (
    b"*RST;*CLS;:INIT:CONT OFF;:FREQ:STAR 954 MHZ;STOP 990 MHZ;:BAND 30 KHZ;:SWE:POIN 2401;TIME 2;:DET RMS;"
    b":FORM REAL,32\n"
)
BLOCK_BYTES = len("#49604") + 4 * 2401 + 1


@pytest.fixture
def analyzer() -> Iterator[AnalyzerThread]:
    with start_in_thread(Instrument(StandingSource.endless(), TracePainter(1))) as handle:
        yield handle


def test_garbage_never_ends_the_connection(analyzer: AnalyzerThread) -> None:
    with RawLine(analyzer.port) as line:
        line.write(bytes(range(256)).replace(b"'", b"").replace(b'"', b"") * 20 + b"\n")
        line.write(b"x" * 3_000_000 + b"\n")
        assert line.ask("*IDN?") == IDENTITY
        assert int(line.ask("SYST:ERR:COUN?")) > 1


def test_reset_fault_breaks_the_connection_and_the_next_one_works(analyzer: AnalyzerThread) -> None:
    with RawLine(analyzer.port) as line:
        line.write(SETUP + b"INIT\n")
        analyzer.faults.arm(LineFault.RESET_IN_BLOCK)
        line.write(b"*OPC?\n")
        assert line.received(2) == b"1\n", "a fault of blocks leaves other answers alone"
        line.write(b"TRAC? TRACE1\n")
        with pytest.raises(ConnectionError):
            line.received(BLOCK_BYTES)
    with RawLine(analyzer.port) as line:
        assert line.ask("*OPC?") == "1"


@pytest.mark.parametrize("fault", [LineFault.RESET, LineFault.CLOSE])
def test_answer_lost_with_its_connection(analyzer: AnalyzerThread, fault: LineFault) -> None:
    analyzer.faults.arm(fault)
    with RawLine(analyzer.port) as line:
        line.write(b"*IDN?\n")
        with pytest.raises(ConnectionError) as ended:
            line.received(1)
        assert isinstance(ended.value, ConnectionResetError) is (fault is LineFault.RESET)
    assert analyzer.faults.remaining == 0


def test_silence_half_a_block_and_garbage_keep_the_connection(analyzer: AnalyzerThread) -> None:
    with RawLine(analyzer.port) as line:
        line.write(SETUP + b"INIT\n")
        analyzer.faults.arm(LineFault.SILENT)
        line.write(b"*IDN?\n")
        assert line.hears_nothing()
        analyzer.faults.arm(LineFault.HALF_BLOCK)
        line.write(b"TRAC? TRACE1\n")
        line.received(BLOCK_BYTES // 2)
        assert line.hears_nothing()
        analyzer.faults.arm(LineFault.GARBAGE)
        line.write(b"*IDN?\n")
        assert line.received(len(GARBAGE_BYTES)) == GARBAGE_BYTES
        assert line.ask("*OPC?") == "1"


def test_a_stale_answer_comes_before_the_next_one(analyzer: AnalyzerThread) -> None:
    with RawLine(analyzer.port) as line, RawLine(analyzer.port) as other:
        analyzer.faults.arm(LineFault.STALE)
        line.write(b"*ESE?\n")
        while analyzer.faults.remaining:
            time.sleep(0.001)
        assert line.hears_nothing()
        assert other.ask("*OPC?") == "1", "it waits in its own session"
        line.write(b"FORM?\n")
        assert line.received(8) == b"0\nASC,0\n"


def test_a_late_answer_delays_those_after_it(analyzer: AnalyzerThread) -> None:
    with RawLine(analyzer.port) as line:
        analyzer.faults.late_by_s = 0.3
        analyzer.faults.arm(LineFault.LATE)
        began_s = time.monotonic()
        line.write(b"*ESE?\n*OPC?\n")
        assert line.received(4) == b"0\n1\n"
        assert time.monotonic() - began_s >= 0.3


def test_the_sweep_of_a_client_that_left_takes_no_row_once_it_is_aborted() -> None:
    allowed, source = threading.Event(), StandingSource.endless()
    instrument = Instrument(source, TracePainter(1), may_advance=allowed.is_set)
    with start_in_thread(instrument) as handle, RawLine(handle.port) as other:
        with RawLine(handle.port) as waiting:
            waiting.write(SETUP + b"INIT;*OPC?\n")
            while other.ask("STAT:OPER:COND?") != "32":
                time.sleep(0.005)
        assert other.ask(":ABOR;*OPC?") == "1"
        allowed.set()
        assert other.ask("INIT;*OPC?") == "1"
        assert source.row == 1


def test_client_that_resets_does_not_harm_the_server(analyzer: AnalyzerThread) -> None:
    for _ in range(5):
        line = RawLine(analyzer.port)
        line.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        line.write(SETUP + b"INIT;*OPC?\nTRAC? TRACE1\n" * 20)
        line.close()
    with RawLine(analyzer.port) as line:
        assert line.ask("*OPC?") == "1"
