"""The simulated analyzer on a real socket: third-party client, several sessions, faults of the line, the process."""

import json
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest
from analyzer_thread import AnalyzerThread, start_in_thread
from standing_source import StandingSource

from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.dialects.rs import IDENTITY
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import TracePainter
from analyzer_sim.instrument.sweep_progress import Pace, SweepProgress
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


def connect(port: int) -> socket.socket:
    line = socket.create_connection(("127.0.0.1", port), timeout=120.0)
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return line


def receive(line: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        chunk = line.recv(1 << 16)
        if not chunk:
            break
        data += chunk
    return data


def ask(line: socket.socket, question: bytes) -> bytes:
    line.sendall(question + b"\n")
    answer = b""
    while not answer.endswith(b"\n"):
        answer += line.recv(1 << 16)
    return answer[:-1]


def hears_nothing(line: socket.socket, for_s: float = 0.2) -> bool:
    line.settimeout(for_s)
    try:
        return line.recv(1) == b"never"
    except TimeoutError:
        return True
    finally:
        line.settimeout(120.0)


def test_garbage_never_ends_the_connection(analyzer: AnalyzerThread) -> None:
    with connect(analyzer.port) as line:
        line.sendall(bytes(range(256)).replace(b"'", b"").replace(b'"', b"") * 20 + b"\n")
        line.sendall(b"x" * 3_000_000 + b"\n")
        assert ask(line, b"*IDN?").decode() == IDENTITY
        assert int(ask(line, b"SYST:ERR:COUN?")) > 1


def test_message_may_arrive_byte_by_byte_and_several_at_once(analyzer: AnalyzerThread) -> None:
    with connect(analyzer.port) as line:
        for byte in b"*ID":
            line.sendall(bytes([byte]))
            time.sleep(0.002)
        line.sendall(b"N?\r\n*OPC?\n*OPC?\n")
        expected = IDENTITY.encode() + b"\n1\n1\n"
        assert receive(line, len(expected)) == expected


def test_reset_fault_breaks_the_connection_and_the_next_one_works(analyzer: AnalyzerThread) -> None:
    with connect(analyzer.port) as line:
        line.sendall(SETUP + b"INIT\n")
        analyzer.faults.arm(LineFault.RESET_IN_BLOCK)
        line.sendall(b"*OPC?\n")
        assert receive(line, 2) == b"1\n", "a fault of blocks leaves other answers alone"
        line.sendall(b"TRAC? TRACE1\n")
        try:
            data = receive(line, BLOCK_BYTES)
        except ConnectionResetError:
            data = b""
        assert len(data) < BLOCK_BYTES
    with connect(analyzer.port) as line:
        assert ask(line, b"*OPC?") == b"1"


@pytest.mark.parametrize("fault", [LineFault.RESET, LineFault.CLOSE])
def test_answer_lost_with_its_connection(analyzer: AnalyzerThread, fault: LineFault) -> None:
    analyzer.faults.arm(fault)
    with connect(analyzer.port) as line:
        line.sendall(b"*IDN?\n")
        try:
            data = line.recv(100)
        except ConnectionResetError:
            assert fault is LineFault.RESET
        else:
            assert data == b""
            assert fault is LineFault.CLOSE
    assert analyzer.faults.remaining == 0


def test_silence_half_a_block_and_garbage_keep_the_connection(analyzer: AnalyzerThread) -> None:
    with connect(analyzer.port) as line:
        line.sendall(SETUP + b"INIT\n")
        analyzer.faults.arm(LineFault.SILENT)
        line.sendall(b"*IDN?\n")
        assert hears_nothing(line)
        analyzer.faults.arm(LineFault.HALF_BLOCK)
        line.sendall(b"TRAC? TRACE1\n")
        assert len(receive(line, BLOCK_BYTES // 2)) == BLOCK_BYTES // 2
        assert hears_nothing(line)
        analyzer.faults.arm(LineFault.GARBAGE)
        line.sendall(b"*IDN?\n")
        assert receive(line, len(GARBAGE_BYTES)) == GARBAGE_BYTES
        assert ask(line, b"*OPC?") == b"1"


def test_a_stale_answer_comes_before_the_next_one(analyzer: AnalyzerThread) -> None:
    with connect(analyzer.port) as line, connect(analyzer.port) as other:
        analyzer.faults.arm(LineFault.STALE)
        line.sendall(b"*ESE?\n")
        while analyzer.faults.remaining:
            time.sleep(0.001)
        assert hears_nothing(line)
        assert ask(other, b"*OPC?") == b"1", "it waits in its own session"
        line.sendall(b"FORM?\n")
        assert receive(line, 8) == b"0\nASC,0\n"


def test_a_late_answer_delays_those_after_it(analyzer: AnalyzerThread) -> None:
    with connect(analyzer.port) as line:
        analyzer.faults.late_by_s = 0.3
        analyzer.faults.arm(LineFault.LATE)
        began_s = time.monotonic()
        line.sendall(b"*ESE?\n*OPC?\n")
        assert receive(line, 4) == b"0\n1\n"
        assert time.monotonic() - began_s >= 0.3


READ_TRACE = {
    "rs": b"TRAC? TRACE1",
    "keysight": b"TRAC? TRACE1",
    "siglent": b"TRAC:DATA? 1",
    "anritsu": b"TRAC:DATA? 1",
}


@pytest.mark.parametrize("name", list(DIALECTS))
def test_every_dialect_sweeps_at_real_pace(name: str) -> None:
    dialect, source = DIALECTS[name], StandingSource.endless()
    instrument = Instrument(source, TracePainter(1), model=dialect.model, progress=SweepProgress(Pace.REAL))
    with start_in_thread(instrument, dialect=dialect) as handle, connect(handle.port) as line:
        line.sendall(b"*RST;*CLS;:FREQ:STAR 954 MHZ;STOP 990 MHZ;:BAND 30 KHZ;:SWE:TIME 0.15;:INIT:CONT ON\n")
        began_s = time.monotonic()
        traces = {ask(line, READ_TRACE[name]) for _ in range(3)}
        while len(traces) < 3:
            traces.add(ask(line, READ_TRACE[name]))
        assert time.monotonic() - began_s > 0.1, "a fresh trace takes a sweep"
        line.sendall(b"INIT:CONT OFF\n")
        began_s = time.monotonic()
        assert ask(line, b"INIT;*OPC?") == b"1"
        assert time.monotonic() - began_s >= 0.15
        assert len(ask(line, READ_TRACE[name])) > 5000
        assert source.row == 1
        assert b"No error" in ask(line, b"SYST:ERR?")


def test_the_sweep_of_a_client_that_left_takes_no_row_once_it_is_aborted() -> None:
    allowed, source = threading.Event(), StandingSource.endless()
    instrument = Instrument(source, TracePainter(1), may_advance=allowed.is_set)
    with start_in_thread(instrument) as handle, connect(handle.port) as other:
        with connect(handle.port) as waiting:
            waiting.sendall(SETUP + b"INIT;*OPC?\n")
            while ask(other, b"STAT:OPER:COND?") != b"32":
                time.sleep(0.005)
        assert ask(other, b":ABOR;*OPC?") == b"1"
        allowed.set()
        assert ask(other, b"INIT;*OPC?") == b"1"
        assert source.row == 1


def test_client_that_resets_does_not_harm_the_server(analyzer: AnalyzerThread) -> None:
    for _ in range(5):
        line = connect(analyzer.port)
        line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        line.sendall(SETUP + b"INIT;*OPC?\nTRAC? TRACE1\n" * 20)
        line.close()
    with connect(analyzer.port) as line:
        assert ask(line, b"*OPC?") == b"1"


def test_taken_port_is_an_error(analyzer: AnalyzerThread) -> None:
    with pytest.raises(OSError, match="address already in use"):
        start_in_thread(Instrument(StandingSource.endless(), TracePainter(1)), port=analyzer.port)


@pytest.fixture
def simulator() -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "analyzer_sim", "--port", "0", "--ground-port", "0", "--seed", "3"]
    command += ["--scenario", "demo", "--operation-days", "0.1", "--await-ground"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        yield process
        process.kill()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_process_tells_its_ports_steps_with_the_ground_and_ends_cleanly(
    simulator: subprocess.Popen[str], number: signal.Signals
) -> None:
    assert simulator.stdout is not None
    ready = json.loads(simulator.stdout.readline())
    assert (ready["scenario"], ready["seed"]) == ("demo", 3)
    with connect(ready["scpi_port"]) as line, connect(ready["ground_port"]) as ground:
        line.sendall(SETUP + b"INIT;*OPC?\n")
        lines = ground.makefile("rw")
        while json.loads(lines.readline())["kind"] != "hold":
            pass
        assert hears_nothing(line, 0.3)
        lines.write('{"kind":"proceed"}\n')
        lines.flush()
        assert receive(line, 2) == b"1\n"
        assert ask(line, b"SIM:EPOCH?") == b"2026-11-01T00:00:00.000000Z"
        assert ask(line, b"SYST:ERR?") == b'0,"No error"'
        simulator.send_signal(number)
        assert simulator.wait(120.0) == 0
    assert simulator.stderr is not None
    assert simulator.stderr.read() == ""
