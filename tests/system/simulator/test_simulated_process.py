"""The simulator's process: its command line, ports and truth."""

import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recording_service import Recorder

from analyzer_sim.world.ground import ground
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World

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


SEED = 20261122
ROWS = 60
WORLD = ["--scenario", "nominal", "--seed", str(SEED), "--operation-days", "0.1"]


def simulator(log: Path, environment: dict[str, str]) -> tuple[subprocess.Popen[str], dict[str, Any]]:
    command = [sys.executable, "-m", "analyzer_sim", *WORLD, "--port", "0", "--ground-port", "0", "--hislip-port", "0"]
    process = subprocess.Popen(
        [*command, "--ideal", "--truth-log", str(log)], stdout=subprocess.PIPE, text=True, env=environment
    )
    assert process.stdout is not None
    return process, json.loads(process.stdout.readline())


def front_end(
    folder: Path, ports: dict[str, Any], service_port: int, environment: dict[str, str]
) -> subprocess.Popen[str]:
    resource = f"TCPIP::127.0.0.1::hislip0,{ports['hislip_port']}::INSTR"
    command = [sys.executable, "-m", "service", "acquire", "--task", str(folder / "task.json"), "--resource", resource]
    command += ["--spacecraft", "sc", "--service", f"http://127.0.0.1:{service_port}", "--epoch", "analyzer"]
    command += ["--period", "0", "--spool", str(folder / "spool")]
    return subprocess.Popen(command, env=environment | {"SOO_KEY": "key"}, stderr=subprocess.PIPE, text=True)


def test_every_trace_that_left_is_a_row_and_every_row_is_true(
    tmp_path: Path, compiled_environment: dict[str, str]
) -> None:
    print(f"seed {SEED}")
    world = World(scenario_named("nominal", operation_days=0.1), SEED)
    (tmp_path / "task.json").write_text(json.dumps(ground.task(world, world.plan_versions[0].carriers)))
    environment = os.environ | compiled_environment
    recorder = Recorder(list(world.carrier_ids))
    recorder.start()
    sim, ports = simulator(tmp_path / "truth.jsonl", environment)
    acquire = front_end(tmp_path, ports, recorder.port, environment)
    try:
        deadline_s = time.monotonic() + 120.0
        while len(recorder.rows) < ROWS and time.monotonic() < deadline_s and acquire.poll() is None:
            time.sleep(0.02)
        acquire.send_signal(signal.SIGTERM)
        _, said = acquire.communicate(timeout=120.0)
        assert acquire.returncode == 0, said
    finally:
        acquire.kill()
        sim.kill()
        sim.communicate()
        recorder.stop()
    lines = [json.loads(text) for text in (tmp_path / "truth.jsonl").read_text().splitlines()]
    sweeps = {line["sweep"]: line for line in lines if line["kind"] == "sweep"}
    traces = [line for line in lines if line["kind"] == "trace"]
    assert len(recorder.rows) >= ROWS, said
    assert sorted(recorder.rows) == sorted({line["epoch"] for line in traces}), "neither lost nor doubled nor made up"
    truth = {line["epoch"]: list(sweeps[line["sweep"]]["power_dbm"].values()) for line in traces}
    epochs = sorted(recorder.rows)
    measured_dbm = np.array([recorder.rows[epoch]["power_dbm"] for epoch in epochs], dtype=float)
    error_db = measured_dbm - np.array([truth[epoch] for epoch in epochs], dtype=float)
    # seen: .07 to .12 dB for one sweep, the mean of each carrier within .02 dB; four times the error of a mean allowed
    assert np.nanstd(error_db) < 0.15
    assert np.max(np.abs(np.nanmean(error_db, axis=0))) < 0.05


DAYS = 0.25
PLANT_ROWS = 360
PLANT_SEED = 1
COMMAND = [sys.executable, "-m", "analyzer_sim", "plant", "--scenario", "nominal", "--seed", str(PLANT_SEED)]
#: about yaw, roll, pitch, kg m2
INERTIA = {"yaw": 2600.0, "roll": 2600.0, "pitch": 1400.0}
QUANTUM_N_M = 0.002


@pytest.fixture
def plant() -> Iterator[subprocess.Popen]:
    command = [*COMMAND, "--operation-days", str(DAYS)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        yield process
        if process.poll() is None:
            process.kill()


def say(process: subprocess.Popen, data: bytes) -> None:
    process.stdin.write(data + b"\n")
    process.stdin.flush()


def steered(truth: dict) -> dict:
    """Return pulses of one quantum whose mean over a minute works against what the truth says."""
    frequency, damping = 2.0 * math.pi / 7200.0, 0.9
    still = {"roll_n_m": 0.0, "pitch_n_m": 0.0, "yaw_n_m": 0.0}
    elements = []
    for axis, inertia in INERTIA.items():
        rate = truth["rates_deg_s"][axis]
        torque = -inertia * math.radians(frequency**2 * truth[f"{axis}_deg"] + 2.0 * damping * frequency * rate)
        one = math.copysign(QUANTUM_N_M, torque)
        duration_s = max(1e-3, min(60.0, abs(torque) * 60.0 / QUANTUM_N_M))
        elements.append({"start": truth["epoch"], "duration_s": duration_s, **still, f"{axis}_n_m": one})
    return {"schedule": elements}


def test_a_loop_closes_over_pipes(plant) -> None:
    answered, largest_deg, truth, began_s = 0, 0.0, {}, 0.0
    for text in plant.stdout:
        line = json.loads(text)
        if line["type"] == "truth":
            truth = line
        if line["type"] == "end":
            break
        if line["type"] == "row" and "rates_deg_s" in truth:
            began_s = began_s or time.perf_counter()
            assert truth["epoch"] == line["epoch"]
            largest_deg = max(largest_deg, abs(truth["roll_deg"]), abs(truth["pitch_deg"]))
            say(plant, json.dumps(steered(truth)).encode())
            answered += 1
    rate = answered / (time.perf_counter() - began_s)
    print(f"seed {PLANT_SEED}: {answered} rows at {rate:.0f} rows/s, roll and pitch within {largest_deg:.3f} deg")
    assert answered == PLANT_ROWS
    assert plant.wait(120) == 0
    assert largest_deg < 0.1
    assert plant.stderr.read() == b""


OTHERS = [pytest.param(data, marks=pytest.mark.slow) for data in (b"\xff\xfe\x00", b"")]


@pytest.mark.parametrize("data", [b'{"schedule":[{"start":1}]}', *OTHERS])
def test_a_bad_line_is_answered(plant, data: bytes) -> None:
    truth = {}
    for text in plant.stdout:
        line = json.loads(text)
        truth = line if line["type"] == "truth" else truth
        if line["type"] == "row" and "rates_deg_s" in truth:
            break
    say(plant, data)
    assert json.loads(plant.stdout.readline())["type"] == "error"
    say(plant, b'{"schedule":[]}')
    types = [json.loads(plant.stdout.readline())["type"] for _ in range(3)]
    assert types == ["ground", "truth", "row"]
    plant.stdin.close()
    assert plant.wait(120) == 0


def test_a_reader_that_leaves_ends_the_plant_in_silence(plant) -> None:
    plant.stdout.readline()
    plant.stdout.close()
    plant.stdin.close()
    assert plant.wait(120) == 0
    assert plant.stderr.read() == b""
