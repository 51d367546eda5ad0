"""The simulated instrument whose craft is flown, as a process: SCPI, ground port and uplink over real sockets."""

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator

import pytest

pytestmark = [pytest.mark.system, pytest.mark.slow]

SEED = 1
STORY = ("--scenario", "slew_fade", "--seed", str(SEED), "--quiet-days", "0.02", "--operation-days", "0.02")
COMMAND = [sys.executable, "-m", "analyzer_sim", *STORY, "--port", "0", "--ground-port", "0", "--uplink-port", "0"]
PROCEED = b'{"kind":"proceed"}'


class Line:
    """A socket, line by line."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=120.0)
        self._lines = self._socket.makefile("rb")

    def say(self, data: bytes) -> None:
        self._socket.sendall(data + b"\n")

    def read(self) -> bytes:
        return self._lines.readline()

    def on_input(self) -> dict:
        return json.loads(self.read())

    def until(self, name: str, wanted: str) -> list[dict]:
        lines = [self.on_input()]
        while lines[-1].get(name) != wanted:
            lines.append(self.on_input())
        return lines

    def close(self) -> None:
        self._lines.close()
        self._socket.close()


@pytest.fixture
def ports() -> Iterator[dict]:
    with subprocess.Popen([*COMMAND, "--await-ground"], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        yield json.loads(process.stdout.readline())
        process.send_signal(signal.SIGTERM)
        assert process.wait(120) == 0
        assert process.stderr.read() == b""


def sweep_to_operation(scpi: Line, ground: Line) -> str:
    """Let every row before operation pass and return the epoch of the first row of operation, already swept."""
    rows = 0
    while True:
        lines = ground.until("kind", "hold")
        rows += sum(len(line["rows"]) for line in lines if line["kind"] == "truth")
        ground.say(PROCEED)
        if lines[-1]["phase"] == "operation":
            break
    scpi.say(b"INIT:CONT OFF")
    for _ in range(rows + 1):
        scpi.say(b"INIT;*OPC?")
        assert scpi.read() == b"1\n"
    return lines[-1]["until"]


def test_schedules_turn_the_craft_and_reports_come_back(ports) -> None:
    print(f"seed {SEED}")
    scpi, ground, uplink = (Line(ports[f"{name}_port"]) for name in ("scpi", "ground", "uplink"))
    assert uplink.on_input()["type"] == "start"
    uplink.say(b'{"schedule":[]}')
    assert uplink.on_input()["type"] == "error", "the spacecraft is under its sensors"
    epoch = sweep_to_operation(scpi, ground)
    assert uplink.on_input() == {"type": "flown", "epoch": epoch}
    # as hard as it goes for a minute: 3 N m s, the spacecraft turns over and over
    element = {"start": epoch, "duration_s": 60.0, "roll_n_m": 0.05, "pitch_n_m": 0.05, "yaw_n_m": -0.05}
    uplink.say(json.dumps({"schedule": [element], "counter": 5}).encode())
    assert uplink.on_input() == {"type": "taken", "counter": 5, "sent": epoch}
    truth = ground.until("kind", "truth")[-1]["rows"]
    for _ in range(10):
        ground.until("kind", "hold")
        ground.say(PROCEED)
        scpi.say(b"INIT;*OPC?")
        assert scpi.read() == b"1\n"
        truth += ground.until("kind", "truth")[-1]["rows"]
    assert [row["epoch"] for row in truth] == sorted({row["epoch"] for row in truth})
    assert truth[0]["epoch"] == epoch
    assert abs(truth[-1]["pitch_deg"] - truth[0]["pitch_deg"]) > 20.0
    reported = uplink.until("epoch", truth[-1]["epoch"])
    assert [(line["counter"], line["state"]) for line in reported if line["type"] == "report"] == [(5, "executed")]
    # no carrier reaches the analyzer any more; what is left is noise, and the instrument still answers
    scpi.say(b"FORM ASC;:TRAC? TRACE1")
    assert all(-200.0 < float(level) < 0.0 for level in scpi.read().split(b","))
    for line in (scpi, ground, uplink):
        line.close()
