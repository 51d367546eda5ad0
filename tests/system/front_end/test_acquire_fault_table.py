"""Every fault of line, trace and neighbours ends in correct levels or in a flagged gap, over socket and HiSLIP.

One acquisition a transport runs through all faults of the table, so that none of them leaves anything behind. A row is
correct when every level lies within six sigma of the truth, or is null with a flag. What is late or lost is judged when
the machine let the test run meanwhile: a fault during which it stood still is caused again.
"""

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import pytest
import pyvisa
from analyzer_thread import AnalyzerThread, start_in_thread
from fault_table import TABLE, FaultRow
from steady_world import CARRIERS, Steady, steady_task
from waiting import wait_until

from analyzer_sim.instrument.imperfections import IDEAL, TraceFault
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import Detail, TracePainter
from analyzer_sim.lines.line_faults import LineFault
from service.client.backoff import Backoff
from service.frontend.acquisition.evaluation import MeasuredRow
from service.frontend.acquisition.states import AcquisitionSettings
from service.frontend.station import Acquisition
from service.records.levels.measurement import QualityFlag, flag_names

# the VISA library leaves the socket of a session that it could not open to the collector
pytestmark = [pytest.mark.system, pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")]

SEED = 11
PERIOD_S = 0.8
#: far above what a loaded machine needs for an answer, far below a period
IO_TIMEOUT_S = 0.4
#: longest time that the test may stand still during a fault that is judged, and how often a fault is caused at most
STILL_S = 0.5 * IO_TIMEOUT_S
ATTEMPTS = 8
#: carriers that every good row has; the beacon is too weak for sweeps as short as these
MODULATED = 4
#: flags of a row in which nothing is wrong: two carriers are weak on purpose
USUAL = {"SIMULATED", "LOW_C_N", "NO_CARRIER"}
TRUTH_DBM = np.array([level for _, _, level in CARRIERS.values()])
LINE_FAULTS = {
    "connection reset": LineFault.RESET,
    "connection closed": LineFault.CLOSE,
    "no answer": LineFault.SILENT,
    "garbage": LineFault.GARBAGE,
    "reset in a block": LineFault.RESET_IN_BLOCK,
    "half a block": LineFault.HALF_BLOCK,
    "stale answer": LineFault.STALE,
    "late answer": LineFault.LATE,
}
TRACE_FAULTS = {
    "one value missing": TraceFault.SHORT,
    "one value too many": TraceFault.LONG,
    "no value at all": TraceFault.EMPTY,
    "trace in dBuV": TraceFault.UNIT_DBUV,
    "trace in W": TraceFault.UNIT_WATT,
    "NaN": TraceFault.NAN,
    "-999": TraceFault.NO_RESULT,
    "9.91E37": TraceFault.SCPI_NAN,
    "9.9E37": TraceFault.SCPI_INFINITY,
}
FOREIGN = {
    "unit changed by another client": "UNIT:POW V",
    "span changed by another client": "FREQ:STOP 980E6",
    "reset by another client": "*RST",
}


class Stillness(threading.Thread):
    """The longest time for which this thread was kept from running."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.over = threading.Event()
        self.longest_s = 0.0

    def run(self) -> None:
        """Look every hundredth of a second."""
        seen_s = time.monotonic()
        while not self.over.wait(0.01):
            seen_s, before_s = time.monotonic(), seen_s
            self.longest_s = max(self.longest_s, seen_s - before_s)


class Trial(NamedTuple):
    """Outcome of a fault."""

    #: periods to the next good row
    recovery: float
    lost: int
    is_reopened: bool
    flags: set[str]


class Bench:
    """An analyzer and an acquisition that goes on through all faults."""

    def __init__(self, *, is_hislip: bool) -> None:
        print(f"seed {SEED}")
        self.is_hislip = is_hislip
        self.allowed = threading.Event()
        self.allowed.set()
        self.instrument = Instrument(Steady(), TracePainter(SEED, IDEAL, Detail.FAST), self.allowed.is_set)
        self.analyzer: AnalyzerThread = start_in_thread(self.instrument, hislip_port=0)
        self.ports = (self.analyzer.port, self.analyzer.hislip_port)
        self.analyzer.faults.late_by_s = 2.0 * IO_TIMEOUT_S
        self.rows: list[tuple[float, MeasuredRow]] = []
        self.stop = threading.Event()
        self.stillness = Stillness()
        self.stillness.start()
        self.acquisition = Acquisition(
            steady_task(time_s=0.1),
            AcquisitionSettings(self.resource, PERIOD_S, use_analyzer_clock=True, io_timeout_s=IO_TIMEOUT_S),
            self._consume,
            lambda: 0,
            self.stop,
            Backoff(first_s=0.05, limit_s=0.1),
        )
        self.thread = threading.Thread(target=self.acquisition.run)
        self.thread.start()

    @property
    def resource(self) -> str:
        port, hislip_port = self.ports
        name = f"hislip0,{hislip_port}::INSTR" if self.is_hislip else f"{port}::SOCKET"
        return f"TCPIP::127.0.0.1::{name}"

    def _consume(self, row: MeasuredRow) -> bool:
        self.rows.append((time.monotonic(), row))
        return True

    def await_rows(self, more: int) -> None:
        """Wait for this many further rows."""
        wanted = len(self.rows) + more
        wait_until(lambda: len(self.rows) >= wanted, f"{more} rows")

    def close(self) -> None:
        """Stop everything."""
        self.allowed.set()
        self.stop.set()
        self.thread.join(120.0)
        self.stillness.over.set()
        self.analyzer.stop()
        assert not self.thread.is_alive()


@pytest.fixture(scope="module")
def benches() -> Iterator[tuple[Bench, Bench]]:
    """Give a running bench of each transport for all faults."""
    both = Bench(is_hislip=False), Bench(is_hislip=True)
    for made in both:
        made.await_rows(2)
    yield both
    for made in both:
        made.close()


def other_client(bench: Bench, message: str, *, is_clear: bool = False) -> None:
    """Let another client send a message while a sweep is held in the middle."""
    bench.allowed.clear()
    wait_until(lambda: bench.instrument.is_pending, "a sweep to be held")
    client = pyvisa.ResourceManager("@py").open_resource(
        f"TCPIP::127.0.0.1::hislip0,{bench.ports[1]}::INSTR", write_termination="\n", timeout=120_000
    )
    try:
        if is_clear:
            client.clear()
        client.write(message)
        client.query("SYST:ERR?")
    finally:
        client.close()
        bench.allowed.set()


def switch_off_and_on(bench: Bench) -> None:
    """Let the analyzer go for half a period."""
    bench.analyzer.stop()
    time.sleep(PERIOD_S / 2)
    bench.analyzer = start_in_thread(bench.instrument, port=bench.ports[0], hislip_port=bench.ports[1])
    bench.analyzer.faults.late_by_s = 2.0 * IO_TIMEOUT_S


def fall_silent(bench: Bench) -> None:
    """Let the analyzer take everything and answer nothing for a while."""
    bench.analyzer.faults.is_silent_peer = True
    time.sleep(PERIOD_S)
    bench.analyzer.faults.is_silent_peer = False


def cause(bench: Bench, fault: str) -> None:
    """Let a fault happen."""
    if fault in LINE_FAULTS:
        bench.analyzer.faults.arm(LINE_FAULTS[fault])
        wait_until(lambda: bench.analyzer.faults.remaining == 0, "the fault to be spent")
    elif fault in TRACE_FAULTS:
        bench.analyzer.trace_faults.arm(TRACE_FAULTS[fault])
        wait_until(lambda: bench.analyzer.trace_faults.remaining == 0, "the fault to be spent")
    elif fault in FOREIGN:
        other_client(bench, FOREIGN[fault])
    else:
        {
            "silent peer": fall_silent,
            "analyzer off and on": switch_off_and_on,
            "device clear in mid-sweep": lambda made: other_client(made, "ABOR", is_clear=True),
        }[fault](bench)


def is_correct(row: MeasuredRow) -> bool:
    """Return whether every level is true, or null with a flag."""
    judged = slice(MODULATED)
    error = np.abs(row.power_dbm - TRUTH_DBM)[judged]
    is_true = error < 6.0 * np.where(np.isnan(row.sigma_db), 0.0, row.sigma_db)[judged]
    is_flagged = np.isnan(row.power_dbm) & (row.flags != int(QualityFlag.SIMULATED))
    return bool((is_true | is_flagged[judged]).all())


def is_good(at_s: float, row: MeasuredRow, ended_s: float) -> bool:
    """Return whether a row after a fault has every level it should have."""
    return at_s > ended_s and bool(np.isfinite(row.power_dbm[:MODULATED]).all())


@pytest.mark.parametrize("expected", TABLE, ids=[row.fault for row in TABLE])
def test_fault(benches: tuple[Bench, Bench], expected: FaultRow) -> None:
    with ThreadPoolExecutor(2) as both:
        for line in both.map(lambda bench: suffer(bench, expected), benches):
            print(line)


def suffer(bench: Bench, expected: FaultRow) -> str:
    """Let a fault happen, check what comes of it, and return that as a row of a table."""
    for _ in range(ATTEMPTS):
        bench.stillness.longest_s = 0.0
        trial = caused(bench, expected)
        if bench.stillness.longest_s < STILL_S:
            break
    else:
        pytest.skip(f"this machine stands still for {STILL_S} s again and again")
    assert trial.recovery < 2.0
    assert trial.lost <= expected.lost
    assert trial.is_reopened == expected.is_reopened
    assert trial.flags == {"RECONNECTED" if expected.is_reopened else expected.flag}
    name = "HiSLIP" if bench.is_hislip else "socket"
    return f"| {expected.fault} | {name} | {', '.join(trial.flags)} | {trial.lost} | {trial.recovery:.1f} |"


def caused(bench: Bench, expected: FaultRow) -> Trial:
    """Let a fault happen once; no row is wrong whatever the machine does."""
    counters = bench.acquisition.counters
    before, sessions = len(bench.rows), counters.sessions
    cause(bench, expected.fault)
    ended_s = time.monotonic()
    if expected.is_reopened:
        # an answer that is late for a machine that stood still is in time
        wait_until(lambda: counters.sessions > sessions or bench.stillness.longest_s >= STILL_S, "another session")
    wait_until(lambda: any(is_good(at_s, row, ended_s) for at_s, row in bench.rows[before:]), "a good row")
    after = bench.rows[before:]
    recovery = (next(at_s for at_s, row in after if is_good(at_s, row, ended_s)) - ended_s) / PERIOD_S
    lost = round((bench.rows[-1][0] - bench.rows[before - 1][0]) / PERIOD_S) - len(after)
    flags = {name for _, row in after for mask in row.flags.tolist() for name in flag_names(mask)} - USUAL
    wrong = [row for _, row in after if not is_correct(row)]
    assert wrong == []
    return Trial(recovery, lost, counters.sessions > sessions, flags)
