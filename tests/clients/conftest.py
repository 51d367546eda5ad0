"""Other people's programs drive the simulated analyzer, each by its own means, and nobody tells them what it is.

The simulator runs as a process of the product's own environment (``SOO_ANALYZER`` names it); the programs run here, in
an environment that does not hold the product. What they measure is compared with the world behind the instrument.
"""

import json
import os
import re
import shutil
import socket
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = os.environ.get("SOO_ANALYZER", str(ROOT / ".venv" / "bin" / "soo-analyzer"))
PYTHON = os.environ.get("SOO_PYTHON", str(ROOT / ".venv" / "bin" / "python"))
STORY = ("--scenario", "nominal", "--seed", "1", "--operation-days", "0.02")

#: resolution bandwidth of the usual sweep: 36 MHz in 2 s, 2401 points
RBW_HZ = 30e3
#: noise bandwidth of a Gaussian filter over its 3 dB width
ENBW_PER_RBW = 1.0645
#: five sigma of the weakest known carrier in that sweep (4.343 / sqrt(1.505 RBW T B / span) = 0.12 dB)
CARRIER_TOLERANCE_DB = 0.6
#: of sixteen such errors the mean has a sigma of 0.025 dB; the noise taken off adds as much
MEAN_TOLERANCE_DB = 0.12

FloatArray = NDArray[np.float64]


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "client(name, transport=, dialect=, work=): one row of the table of clients")
    # what other people's programs warn of is theirs: deprecations, sockets they leave to the collector
    config.addinivalue_line("filterwarnings", "default")


@pytest.fixture(scope="session")
def written(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """Have the service write its messages; return their folder, and the archive that they were made of."""
    folder = tmp_path_factory.mktemp("messages")
    command = [PYTHON, "-m", "tests.clients.write_messages", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return SimpleNamespace(folder=folder, archive=json.loads((folder / "archive.json").read_text()))


@dataclass(frozen=True)
class Truth:
    """The powers at the analyzer's input, row by row of the story."""

    epochs_us: NDArray[np.int64]
    #: (T, N)
    power_dbm: FloatArray
    center_hz: FloatArray
    width_hz: FloatArray
    #: (W, 2) windows without a carrier
    noise_hz: FloatArray

    @classmethod
    def exported(cls, path: Path) -> "Truth":
        """Ask the simulator for its world as arrays."""
        command = [PROGRAM, "export", *STORY, "--sweep-noise", "0", "--out", str(path)]
        subprocess.run(command, check=True, capture_output=True, timeout=120)
        arrays = np.load(path)
        lines = json.loads(str(arrays["catalogue_json"]))
        task = next(line["body"] for line in lines if line["kind"] == "task")
        carriers = task["carriers"]
        return cls(
            arrays["epoch_us"],
            arrays["power_dbm"],
            np.array([carrier["fc_hz"] for carrier in carriers]),
            np.array([carrier["integ_bw_hz"] for carrier in carriers]),
            np.array(carriers[0]["noise"]),
        )

    def at(self, epoch: str) -> FloatArray:
        """Return the powers of the row of an epoch."""
        wanted_us = np.datetime64(epoch.removesuffix("Z"), "us").astype(np.int64)
        rows = np.flatnonzero(self.epochs_us == wanted_us)
        assert len(rows) == 1, epoch
        return self.power_dbm[rows[0]]


def carrier_powers_dbm(truth: Truth, frequency_hz: FloatArray, level_dbm: FloatArray, enbw_hz: float) -> FloatArray:
    """Return what a trace says of each carrier: milliwatts summed over its width, the noise beside it taken off."""
    milliwatts = 10.0 ** (0.1 * np.asarray(level_dbm, float)) / enbw_hz
    step_hz = float(np.mean(np.diff(frequency_hz)))
    quiet = np.zeros(len(frequency_hz), bool)
    for start_hz, stop_hz in truth.noise_hz:
        quiet |= (frequency_hz >= start_hz) & (frequency_hz <= stop_hz)
    powers = []
    for center_hz, width_hz in zip(truth.center_hz, truth.width_hz, strict=True):
        inside = np.abs(frequency_hz - center_hz) <= 0.5 * width_hz
        powers.append(np.sum(milliwatts[inside] - np.mean(milliwatts[quiet])) * step_hz)
    return 10.0 * np.log10(powers)


@dataclass
class Analyzer:
    """A simulator that runs, and the judge's own line to it."""

    dialect: str
    scpi_port: int
    hislip_port: int
    truth: Truth
    _lines: list[socket.socket] = field(default_factory=list)

    @property
    def socket_name(self) -> str:
        """VISA resource of the raw socket."""
        return f"TCPIP::127.0.0.1::{self.scpi_port}::SOCKET"

    @property
    def hislip_name(self) -> str:
        """VISA resource of HiSLIP."""
        return f"TCPIP::127.0.0.1::hislip0,{self.hislip_port}::INSTR"

    def resource_name(self, transport: str) -> str:
        """VISA resource of a transport."""
        return self.hislip_name if transport == "HiSLIP" else self.socket_name

    def ask(self, question: str) -> str:
        """Ask on a line of the judge's own."""
        if not self._lines:
            self._lines.append(socket.create_connection(("127.0.0.1", self.scpi_port), timeout=120.0))
        self._lines[0].sendall(question.encode() + b"\n")
        answer = b""
        while not answer.endswith(b"\n"):
            answer += self._lines[0].recv(1 << 16)
        return answer.decode().strip()

    def close(self) -> None:
        """Close the judge's line."""
        for line in self._lines:
            line.close()

    def true_powers_dbm(self) -> FloatArray:
        """Return the powers of the row that was swept last."""
        return self.truth.at(self.ask("SIM:EPOCH?"))

    def check_trace(self, frequency_hz: Any, level_dbm: Any, *, enbw_hz: float = ENBW_PER_RBW * RBW_HZ) -> None:
        """Fail unless a trace of power averages shows every carrier at its true level."""
        measured = carrier_powers_dbm(self.truth, np.asarray(frequency_hz), np.asarray(level_dbm), enbw_hz)
        errors_db = measured - self.true_powers_dbm()
        assert np.max(np.abs(errors_db)) < CARRIER_TOLERANCE_DB, errors_db.round(2)
        assert abs(np.mean(errors_db)) < MEAN_TOLERANCE_DB, errors_db.round(2)


@pytest.fixture(scope="session")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Truth:
    """The world of the story that every simulator of these tests tells."""
    return Truth.exported(tmp_path_factory.mktemp("world") / "world.npz")


@contextmanager
def running(dialect: str, truth: Truth, *options: str) -> Iterator[Analyzer]:
    """Run a simulator without errors of its own but the statistics of noise."""
    command = [PROGRAM, *STORY, "--dialect", dialect, "--ideal", *options]
    command += ["--port", "0", "--hislip-port", "0", "--ground-port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line, process.communicate()[1]
            ports = json.loads(line)
            simulator = Analyzer(dialect, ports["scpi_port"], ports["hislip_port"], truth)
            yield simulator
            simulator.close()
        finally:
            process.terminate()
            complaints = process.communicate(timeout=120)[1]
    assert complaints == "", "the simulator complained"
    assert process.returncode == 0


@pytest.fixture(scope="session")
def simulators(truth: Truth) -> Iterator[Callable[[str], Analyzer]]:
    """One simulator a dialect, which all its clients visit one after another."""
    with ExitStack() as stack:
        made: dict[str, Analyzer] = {}

        def simulator(dialect: str) -> Analyzer:
            if dialect not in made:
                made[dialect] = stack.enter_context(running(dialect, truth))
            return made[dialect]

        yield simulator


@pytest.fixture
def slow_analyzer(truth: Truth) -> Iterator[Analyzer]:
    """An R&S simulator whose sweeps last their time by the clock on the wall."""
    with running("rs", truth, "--pace", "real") as simulator:
        yield simulator


@pytest.fixture
def analyzer(request: pytest.FixtureRequest, simulators: Callable[[str], Analyzer]) -> Analyzer:
    """The simulator of the dialect that the test's client speaks, as after power-on."""
    simulator = simulators(request.node.get_closest_marker("client").kwargs["dialect"])
    assert simulator.ask("*RST;*CLS;*ESE 0;*SRE 0;*OPC?") == "1"
    return simulator


def version_of(name: str) -> str:
    """Return the version of a client: of its distribution, or what the program says."""
    if name != "lxi-tools":
        return version(name)
    program = shutil.which("lxi")
    if program is None:
        return "not installed"
    reported = subprocess.run([program, "--version"], capture_output=True, text=True, check=False, timeout=120)
    found = re.search(r"\d[\w.]*", reported.stdout)
    return found.group() if found else "?"


ROWS: list[tuple[str, ...]] = []
HEAD = ("client", "version", "transport", "dialect", "what it did", "result")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    report = yield
    marker = item.get_closest_marker("client")
    if marker is not None and (report.when == "call" or report.outcome != "passed"):
        row = marker.kwargs
        reason = getattr(report, "wasxfail", "")
        if report.skipped and not reason:
            reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        result = {"passed": "works", "failed": "FAILS"}.get(report.outcome, reason)
        ROWS.append((marker.args[0], version_of(marker.args[0]), row["transport"], row["dialect"], row["work"], result))
    return report


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print the table of clients."""
    if not ROWS:
        return
    terminalreporter.section("clients")
    rows = [HEAD, *sorted(ROWS)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(HEAD))]
    for row in rows:
        terminalreporter.write_line(
            "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip()
        )
