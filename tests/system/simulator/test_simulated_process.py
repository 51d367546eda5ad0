"""``soo-analyzer`` as a process: every port, real pace, truth log, faults from the command line."""

import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.system

SETUP = "*RST;*CLS;:INIT:CONT OFF;:FREQ:STAR 954 MHZ;STOP 990 MHZ;:BAND 30 KHZ;:SWE:POIN 1201;:DET RMS;:SWE:TIME"
#: of simulated time are enough, and a world of them is made in no time
SHORT = ["--scenario", "nominal", "--seed", "1", "--operation-days", "0.05"]


class Process:
    """One simulator."""

    def __init__(self, environment: dict[str, str], *arguments: str) -> None:
        command = [sys.executable, "-m", "analyzer_sim", *SHORT, "--port", "0", "--ground-port", "0", *arguments]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
        )
        assert self.process.stdout is not None
        self.ports: dict[str, Any] = json.loads(self.process.stdout.readline())

    def connect(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.ports["scpi_port"]), timeout=120.0)

    def end(self) -> tuple[int, str]:
        self.process.send_signal(signal.SIGTERM)
        _, errors = self.process.communicate(timeout=120.0)
        return self.process.returncode, errors


Start = Callable[..., Process]


@pytest.fixture
def start(compiled_environment: dict[str, str]) -> Iterator[Start]:
    started: list[Process] = []

    def begin(*arguments: str) -> Process:
        started.append(Process(compiled_environment, *arguments))
        return started[-1]

    yield begin
    for made in started:
        if made.process.poll() is None:
            made.process.kill()
        made.process.communicate()


@pytest.fixture(scope="module")
def every_port(compiled_environment: dict[str, str]) -> Iterator[Process]:
    """A simulator with all kinds of ports, for tests that leave it as it was."""
    made = Process(compiled_environment, "--hislip-port", "0", "--alias-port", "0", "--alias-port", "0")
    try:
        yield made
        assert made.end() == (0, "")
    finally:
        made.process.kill()
        made.process.communicate()


@pytest.fixture(scope="module")
def real_pace(compiled_environment: dict[str, str]) -> Iterator[Process]:
    """A simulator at real pace, for tests that set it up themselves."""
    made = Process(compiled_environment, "--pace", "real", "--hislip-port", "0")
    yield made
    made.process.kill()
    made.process.communicate()


def receive_line(line: socket.socket) -> str:
    answer = b""
    while not answer.endswith(b"\n"):
        chunk = line.recv(1 << 16)
        assert chunk, "the peer has left"
        answer += chunk
    return answer.decode("latin-1").rstrip("\n")


def ask(line: socket.socket, question: str) -> str:
    line.sendall(question.encode() + b"\n")
    return receive_line(line)


def visa(ports: dict[str, Any]) -> Any:
    import pyvisa

    return pyvisa.ResourceManager("@py").open_resource(
        f"TCPIP::127.0.0.1::hislip0,{ports['hislip_port']}::INSTR",
        read_termination="\n",
        write_termination="\n",
        timeout=120_000,
    )


def test_all_ports_are_the_same_instrument(every_port: Process) -> None:
    made = every_port
    assert (made.ports["dialect"], made.ports["scenario"], made.ports["seed"]) == ("rs", "nominal", 1)
    assert len(made.ports["alias_ports"]) == 2
    with made.connect() as line:
        ask(line, "SWE:POIN 501;*OPC?")
    for port in made.ports["alias_ports"]:
        with socket.create_connection(("127.0.0.1", port), timeout=120.0) as line:
            assert ask(line, "SWE:POIN?") == "501"
    session = visa(made.ports)
    assert session.query("SWE:POIN?") == "501"
    session.close()


def test_truth_log_counts_every_trace_that_left(start: Start, tmp_path: Path) -> None:
    path = tmp_path / "truth.jsonl"
    made = start("--truth-log", str(path), "--hislip-port", "0")
    epochs = []
    with made.connect() as line:
        line.sendall(f"{SETUP} 2\n".encode())
        for _ in range(20):
            assert ask(line, "INIT;*OPC?") == "1"
            epochs.append(ask(line, "SIM:EPOCH?"))
            assert ask(line, "TRAC? TRACE1").count(",") == 1200
    session = visa(made.ports)
    assert session.query("INIT;*OPC?") == "1"
    assert len(session.query_ascii_values("TRAC? TRACE1")) == 1201
    assert session.query("*OPC?") == "1", "what came before is done, its line in the log too"
    lines = [json.loads(text) for text in path.read_text().splitlines()]  # flushed: the process still runs
    session.close()
    assert lines[0]["kind"] == "world"
    sweeps = {item["sweep"]: item for item in lines if item["kind"] == "sweep"}
    traces = [item for item in lines if item["kind"] == "trace"]
    assert [item["epoch"] for item in traces[:20]] == epochs
    assert [item["session"] for item in traces] == ["socket 1"] * 20 + ["hislip 1"]
    assert [item["row"] for item in traces] == list(range(21))
    for item in traces:
        assert item["row"] == sweeps[item["sweep"]]["row"]
        assert list(sweeps[item["sweep"]]["power_dbm"]) == lines[0]["carriers"]


def test_half_a_trace_is_not_one_that_left(start: Start, tmp_path: Path) -> None:
    path = tmp_path / "truth.jsonl"
    made = start("--truth-log", str(path), "--fault", "half_block", "--fault", "nan:2")
    assert made.ports["hislip_port"] is None, "HiSLIP is not served unless asked for"
    with made.connect() as line:
        line.sendall(f"{SETUP} 2;:FORM REAL,32;:INIT\nTRAC? TRACE1\n".encode())
        received = b""
        while len(received) < 2 * 1201:
            received += line.recv(1 << 16)
        line.settimeout(0.2)
        with pytest.raises(TimeoutError):
            line.recv(1)
        line.settimeout(120.0)
        line.sendall(b"FORM ASC;:TRAC? TRACE1\n")
        assert "NAN" in receive_line(line)
        assert "NAN" not in ask(line, "TRAC? TRACE1")
        ask(line, "*OPC?")
    traces = [item for item in map(json.loads, path.read_text().splitlines()) if item["kind"] == "trace"]
    assert [item["spoiled"] for item in traces] == [True, False]


def test_a_silent_peer_accepts_and_never_answers(start: Start) -> None:
    made = start("--fault", "silent_peer")
    with made.connect() as line:
        line.settimeout(0.3)
        line.sendall(b"*IDN?\n")
        with pytest.raises(TimeoutError):
            line.recv(10)
    assert made.end() == (0, "")


def test_at_real_pace_a_sweep_lasts_its_time_and_others_are_served(start: Start) -> None:
    made = start("--pace", "real", "--hislip-port", "0")
    with made.connect() as line, made.connect() as other:
        line.sendall(f"{SETUP} 5\n".encode())
        assert ask(line, "*OPC?") == "1"
        began_s = time.monotonic()
        line.sendall(b"INIT;*OPC?\n")
        while ask(other, "STAT:OPER:COND?") != "8":
            assert time.monotonic() - began_s < 120.0
        other.sendall(b"INIT\n")
        assert ask(other, "SYST:ERR?").startswith("-213")
        assert receive_line(line) == "1"
        # a sweep never ends early
        assert 5.0 <= time.monotonic() - began_s < 120.0
        assert ask(other, "STAT:OPER:COND?;:SIM:EPOCH?").startswith("0;2026-11-01T00:00:00")


def test_device_clear_and_abort_in_mid_sweep_at_real_pace(real_pace: Process) -> None:
    import pyvisa

    session = visa(real_pace.ports)
    session.write(f"{SETUP} 1000;:INIT")
    session.timeout = 200
    with pytest.raises(pyvisa.VisaIOError):
        session.query("*OPC?")
    session.timeout = 120_000
    session.clear()
    assert session.query("STAT:OPER:COND?") == "8", "a device clear leaves the sweep alone"
    session.write("ABOR")
    assert session.query("STAT:OPER:COND?;*OPC?") == "0;1"
    session.write("SWE:TIME 0.1;:INIT")
    assert session.query("*OPC?") == "1", "the long sweep that was aborted does not hold up the short one"
    session.close()


def test_continuous_sweeping_at_real_pace_gives_fresh_traces(real_pace: Process) -> None:
    with real_pace.connect() as line:
        line.sendall(f"{SETUP} 0.2;:INIT:CONT ON\n".encode())
        traces = [ask(line, "TRAC? TRACE1")]
        began_s = time.monotonic()
        # until the same sweep was read more than once, too
        while len(set(traces)) < 3 or len(traces) == len(set(traces)):
            traces.append(ask(line, "TRAC? TRACE1"))
            assert time.monotonic() - began_s < 120.0
        assert time.monotonic() - began_s > 0.2, "more than two sweeps were needed"


def test_a_dozen_sessions_of_both_kinds_at_once(every_port: Process) -> None:
    made = every_port

    def by_socket(number: int) -> int:
        with made.connect() as line:
            return sum(
                ask(line, f"*OPC?;*IDN?;:STAT:QUES:ENAB?;*ESE {number}").startswith("1;Rohde") for _ in range(20)
            )

    def by_hislip(_number: int) -> int:
        session = visa(made.ports)
        right = sum(session.query("*OPC?;*IDN?").startswith("1;Rohde") for _ in range(20))
        session.close()
        return right

    with ThreadPoolExecutor(12) as pool:
        sockets = [pool.submit(by_socket, number) for number in range(8)]
        hislips = [pool.submit(by_hislip, number) for number in range(4)]
        assert [job.result() for job in [*sockets, *hislips]] == [20] * 12
    with made.connect() as line:
        assert ask(line, "SYST:ERR:COUN?") == "0"
