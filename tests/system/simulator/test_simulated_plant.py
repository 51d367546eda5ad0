"""The plant as a study meets it: a process, JSON lines over pipes, a loop closed row by row."""

import json
import math
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

pytestmark = pytest.mark.system

DAYS = 0.25
ROWS = 360
SEED = 1
COMMAND = [sys.executable, "-m", "analyzer_sim", "plant", "--scenario", "nominal", "--seed", str(SEED)]
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
    print(f"seed {SEED}: {answered} rows at {rate:.0f} rows/s, roll and pitch within {largest_deg:.3f} deg")
    assert answered == ROWS
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
