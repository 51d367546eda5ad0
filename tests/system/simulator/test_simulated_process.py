"""The simulator's process: its command line, ports and truth."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recording_service import Recorder
from wire_lines import HislipLine, RawLine

from analyzer_sim.world.ground import ground
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World

pytestmark = pytest.mark.system


SETUP = "*RST;*CLS;:INIT:CONT OFF;:FREQ:STAR 954 MHZ;STOP 990 MHZ;:BAND 30 KHZ;:SWE:POIN 1201;:DET RMS;:SWE:TIME"
#: of simulated time are enough, and a world of them is made in no time
SHORT = ["--scenario", "nominal", "--seed", "1", "--operation-days", "0.05"]


class Process:
    """One simulator."""

    def __init__(self, *arguments: str) -> None:
        command = [sys.executable, "-m", "analyzer_sim", *SHORT, "--port", "0", "--ground-port", "0", *arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.ports: dict[str, Any] = json.loads(self.process.stdout.readline())

    def connect(self) -> RawLine:
        return RawLine(self.ports["scpi_port"])

    def end(self, number: signal.Signals = signal.SIGTERM) -> tuple[int, str]:
        self.process.send_signal(number)
        _, errors = self.process.communicate(timeout=120.0)
        return self.process.returncode, errors


Start = Callable[..., Process]


@pytest.fixture
def start() -> Iterator[Start]:
    started: list[Process] = []

    def begin(*arguments: str) -> Process:
        started.append(Process(*arguments))
        return started[-1]

    yield begin
    for made in started:
        if made.process.poll() is None:
            made.process.kill()
        made.process.communicate()


@pytest.fixture
def real_pace(start: Start) -> Process:
    """A simulator at real pace."""
    return start("--pace", "real", "--hislip-port", "0")


def test_all_ports_are_the_same_instrument(start: Start) -> None:
    made = start("--hislip-port", "0", "--alias-port", "0", "--alias-port", "0")
    assert (made.ports["dialect"], made.ports["scenario"], made.ports["seed"]) == ("rs", "nominal", 1)
    assert len(made.ports["alias_ports"]) == 2
    with made.connect() as line:
        line.ask("SWE:POIN 501;*OPC?")
    for port in made.ports["alias_ports"]:
        with RawLine(port) as line:
            assert line.ask("SWE:POIN?") == "501"
    with HislipLine(made.ports["hislip_port"]) as session:
        assert session.ask("SWE:POIN?") == "501"
    assert made.end() == (0, "")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_process_steps_with_the_ground_and_ends_cleanly(start: Start, number: signal.Signals) -> None:
    made = start("--scenario", "demo", "--seed", "3", "--await-ground")
    assert (made.ports["scenario"], made.ports["seed"]) == ("demo", 3)
    with made.connect() as line, RawLine(made.ports["ground_port"]) as ground:
        line.write(f"{SETUP} 2;:INIT;*OPC?\n".encode())
        while b'"hold"' not in ground.read_until(b"\n"):
            pass
        assert line.hears_nothing(0.3)
        ground.write(b'{"kind":"proceed"}\n')
        assert line.received(2) == b"1\n"
        assert line.ask("SIM:EPOCH?") == "2026-11-01T00:00:00.000000Z"
        assert line.ask("SYST:ERR?") == '0,"No error"'
        assert made.end(number) == (0, "")


def test_truth_log_counts_every_trace_that_left(start: Start, tmp_path: Path) -> None:
    path = tmp_path / "truth.jsonl"
    made = start("--truth-log", str(path), "--hislip-port", "0")
    epochs = []
    with made.connect() as line:
        line.write(f"{SETUP} 2\n".encode())
        for _ in range(20):
            assert line.ask("INIT;*OPC?") == "1"
            epochs.append(line.ask("SIM:EPOCH?"))
            assert line.ask("TRAC? TRACE1").count(",") == 1200
    with HislipLine(made.ports["hislip_port"]) as session:
        assert session.ask("INIT;*OPC?") == "1"
        assert session.ask("TRAC? TRACE1").count(",") == 1200
        assert session.ask("*OPC?") == "1", "what came before is done, its line in the log too"
        lines = [json.loads(text) for text in path.read_text().splitlines()]  # flushed: the process still runs
    assert lines[0]["kind"] == "world"
    sweeps = {item["sweep"]: item for item in lines if item["kind"] == "sweep"}
    traces = [item for item in lines if item["kind"] == "trace"]
    assert [item["epoch"] for item in traces[:20]] == epochs
    assert [item["session"] for item in traces] == ["socket 1"] * 20 + ["hislip 1"]
    assert [item["row"] for item in traces] == list(range(21))
    for item in traces:
        assert item["row"] == sweeps[item["sweep"]]["row"]
        assert list(sweeps[item["sweep"]]["power_dbm"]) == lines[0]["carriers"]


@pytest.mark.slow
def test_half_a_trace_is_not_one_that_left(start: Start, tmp_path: Path) -> None:
    path = tmp_path / "truth.jsonl"
    made = start("--truth-log", str(path), "--fault", "half_block", "--fault", "nan:2")
    assert made.ports["hislip_port"] is None, "HiSLIP is not served unless asked for"
    with made.connect() as line:
        line.write(f"{SETUP} 2;:FORM REAL,32;:INIT\nTRAC? TRACE1\n".encode())
        line.received(len("#44804") + 4 * 1201 + 1 >> 1)
        assert line.hears_nothing()
        assert "NAN" in line.ask("FORM ASC;:TRAC? TRACE1")
        assert "NAN" not in line.ask("TRAC? TRACE1")
        line.ask("*OPC?")
    traces = [item for item in map(json.loads, path.read_text().splitlines()) if item["kind"] == "trace"]
    assert [item["spoiled"] for item in traces] == [True, False]


def test_a_silent_peer_accepts_and_never_answers(start: Start) -> None:
    made = start("--fault", "silent_peer")
    with made.connect() as line:
        line.write(b"*IDN?\n")
        assert line.hears_nothing(0.3)
    assert made.end() == (0, "")


def test_device_clear_and_abort_in_mid_sweep_at_real_pace(real_pace: Process) -> None:
    with HislipLine(real_pace.ports["hislip_port"]) as session:
        session.write(f"{SETUP} 1000;:INIT".encode())
        session.write(b"*OPC?")
        assert session.sync.hears_nothing()
        session.clear()
        assert session.ask("STAT:OPER:COND?") == "8", "a device clear leaves the sweep alone"
        session.write(b"ABOR")
        assert session.ask("STAT:OPER:COND?;*OPC?") == "0;1"
        session.write(b"SWE:TIME 0.1;:INIT")
        assert session.ask("*OPC?") == "1", "the long sweep that was aborted does not hold up the short one"


@pytest.mark.slow
def test_continuous_sweeping_at_real_pace_gives_fresh_traces(real_pace: Process) -> None:
    with real_pace.connect() as line:
        line.write(f"{SETUP} 0.2;:INIT:CONT ON\n".encode())
        traces = [line.ask("TRAC? TRACE1")]
        began_s = time.monotonic()
        # until the same sweep was read more than once, too
        while len(set(traces)) < 3 or len(traces) == len(set(traces)):
            traces.append(line.ask("TRAC? TRACE1"))
            assert time.monotonic() - began_s < 120.0
        assert time.monotonic() - began_s > 0.2, "more than two sweeps were needed"


SEED = 20261122
ROWS = 60
WORLD = ["--seed", str(SEED), "--operation-days", "0.1"]


def front_end(folder: Path, ports: dict[str, Any], service_port: int) -> subprocess.Popen[str]:
    resource = f"TCPIP::127.0.0.1::hislip0,{ports['hislip_port']}::INSTR"
    command = [sys.executable, "-m", "service", "acquire", "--task", str(folder / "task.json"), "--resource", resource]
    command += ["--spacecraft", "sc", "--service", f"http://127.0.0.1:{service_port}", "--epoch", "analyzer"]
    command += ["--period", "0", "--spool", str(folder / "spool")]
    return subprocess.Popen(command, env=os.environ | {"SOO_KEY": "key"}, stderr=subprocess.PIPE, text=True)


@pytest.mark.slow
def test_every_trace_that_left_is_a_row_and_every_row_is_true(start: Start, tmp_path: Path) -> None:
    print(f"seed {SEED}")
    world = World(scenario_named("nominal", operation_days=0.1), SEED)
    (tmp_path / "task.json").write_text(json.dumps(ground.task(world, world.plan_versions[0].carriers)))
    recorder = Recorder(list(world.carrier_ids))
    recorder.start()
    sim = start(*WORLD, "--hislip-port", "0", "--ideal", "--truth-log", str(tmp_path / "truth.jsonl"))
    acquire = front_end(tmp_path, sim.ports, recorder.port)
    try:
        deadline_s = time.monotonic() + 120.0
        while len(recorder.rows) < ROWS and time.monotonic() < deadline_s and acquire.poll() is None:
            time.sleep(0.02)
        acquire.send_signal(signal.SIGTERM)
        _, said = acquire.communicate(timeout=120.0)
        assert acquire.returncode == 0, said
    finally:
        acquire.kill()
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


def test_a_line_that_is_no_text_is_answered(plant) -> None:
    truth = {}
    for text in plant.stdout:
        line = json.loads(text)
        truth = line if line["type"] == "truth" else truth
        if line["type"] == "row" and "rates_deg_s" in truth:
            break
    say(plant, b"\xff\xfe\x00")
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
