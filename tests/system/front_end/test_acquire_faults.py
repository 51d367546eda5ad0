"""The front end over real sockets: whatever line or service does, it says so, waits, goes on, counts every row once.

The analyzer is the simulator in a thread with armed line faults, the service a small recorder that keeps the promise
of the contract.
"""

import json
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analyzer_thread import AnalyzerThread, start_in_thread
from recording_service import Recorder
from waiting import wait_until

from analyzer_sim.emission import EndOfScenario
from analyzer_sim.instrument.imperfections import Imperfections
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import Detail, TracePainter
from analyzer_sim.lines.line_faults import LineFault
from analyzer_sim.world.ground import ground
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World
from service.client.backoff import Backoff
from service.client.service_client import ServiceClient
from service.frontend.acquisition.states import AcquisitionSettings
from service.frontend.measurement_task import MeasurementTask, parse_task
from service.frontend.spool.file import Owner
from service.frontend.spool.row import SpooledTask
from service.frontend.spool.spool import Spool
from service.frontend.station import MeasuringStation, StationSummary
from service.frontend.upload.uploader import UploadSettings
from service.records.levels.measurement import QualityFlag

pytestmark = pytest.mark.system

#: the shortest sweep that settles at 30 kHz over 36 MHz
SWEEP_TIME_S = 0.1
#: where answers get lost, so that this is noticed soon
SHORT_S = 1.0
#: no answer takes so long on any machine
PATIENCE_S = 120.0
SEED = 20261121


class Bench:
    """World, analyzer, recorder and station of one test."""

    def __init__(
        self,
        folder: Path,
        hold_s: float = 0.0,
        io_timeout_s: float = PATIENCE_S,
        service_timeout_s: float = PATIENCE_S,
        **upload: Any,
    ) -> None:
        print(f"seed {SEED}")
        self.world = World(scenario_named("nominal"), SEED)
        painter = TracePainter(SEED, Imperfections(), Detail.FAST)
        self.instrument = Instrument(self.world, painter)
        self.analyzer: AnalyzerThread = start_in_thread(self.instrument)
        self.analyzer.faults.late_by_s = 2.0 * SHORT_S
        self.task = quick_task(self.world)
        self.recorder = Recorder([carrier.id for carrier in self.task.carriers])
        self.recorder.start()
        self.client = ServiceClient(
            f"http://127.0.0.1:{self.recorder.port}", "key", retries=0, timeout_s=service_timeout_s
        )
        ids = tuple(carrier.id for carrier in self.task.carriers)
        self.spool = Spool(folder / "sa-1.spool", Owner("sc", "sa-1"), SpooledTask("0" * 64, ids), lambda: 0)
        self.station = MeasuringStation(
            self.task,
            AcquisitionSettings(
                f"TCPIP::127.0.0.1::{self.analyzer.port}::SOCKET",
                period_s=0.0,
                use_analyzer_clock=True,
                io_timeout_s=io_timeout_s,
                hold_s=hold_s,
            ),
            UploadSettings("sc", "sa-1", **({"drain_s": PATIENCE_S} | upload)),
            self.client,
            self.spool,
            lambda: 0,
            lambda: Backoff(first_s=0.02, limit_s=0.1),
        )
        self.summary: StationSummary | None = None
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        self.summary = self.station.run()

    def start(self) -> None:
        """Start the station."""
        self._thread.start()

    def finish(self) -> StationSummary:
        """Stop the station and return what it came to."""
        self.station.stop()
        self._thread.join(PATIENCE_S)
        assert self.summary is not None
        return self.summary

    def close(self) -> None:
        """Stop everything."""
        self.station.stop()
        if self._thread.is_alive():
            self._thread.join(PATIENCE_S)
        self.client.close()
        self.spool.close()
        self.recorder.stop()
        self.analyzer.stop()

    def await_rows(self, more: int) -> None:
        """Wait until the recorder has taken this many more rows."""
        wanted = len(self.recorder.rows) + more
        wait_until(lambda: len(self.recorder.rows) >= wanted, f"{wanted} rows, {len(self.recorder.rows)} came")

    def swept(self) -> int:
        """Return how many sweeps the world has made."""
        return int(self.world.row_index) + 1


def quick_task(world: World) -> MeasurementTask:
    """Return the task of a world with a short sweep."""
    document = ground.task(world, world.plan_versions[0].carriers)
    document["sweeps"][0]["time_s"] = SWEEP_TIME_S
    return parse_task(json.dumps(document).encode())[0]


@contextmanager
def bench(**settings: Any) -> Iterator[Bench]:
    """Return a running bench and stop it at the end."""
    with tempfile.TemporaryDirectory() as folder:
        made = Bench(Path(folder), **settings)
        try:
            made.start()
            made.await_rows(5)
            yield made
        finally:
            made.close()


def assert_all_counted_once(made: Bench, summary: StationSummary, lost_sweeps: int = 0) -> None:
    """Check rows against sweeps: every sweep that was read is a row, once, in order, and nothing else is."""
    recorder = made.recorder
    epochs = list(recorder.rows)
    assert summary.undelivered == 0
    assert recorder.conflicts == 0
    assert epochs == sorted(epochs)
    assert len(epochs) == summary.acquisition.rows
    assert 0 <= made.swept() - len(epochs) <= lost_sweeps
    covered = {first + k for first, count in recorder.seqs for k in range(count)}
    assert covered == set(range(1, len(epochs) + 1))


def test_undisturbed_every_sweep_is_a_row_with_the_levels_of_the_plan() -> None:
    with bench() as made:
        made.await_rows(100)
        summary = made.finish()
        assert_all_counted_once(made, summary)
        assert summary.acquisition.faults == 0
        levels = np.array([row["power_dbm"] for row in made.recorder.rows.values()], dtype=float)
        nominal = [carrier.limits.nominal_dbm for carrier in made.task.carriers]
        # 1 dB: the analyzer's own offsets (0.25 dB sigma), chain drift (0.3 dB) and the attitude's effect
        np.testing.assert_allclose(np.median(levels, axis=0), nominal, atol=1.0)
        assert all(flag == QualityFlag.SIMULATED for row in made.recorder.rows.values() for flag in row["flags"])


def test_faults_one_after_another_are_outlasted() -> None:
    with bench(io_timeout_s=SHORT_S) as made:
        for fault in LineFault:
            made.analyzer.faults.arm(fault)
        wait_until(lambda: made.analyzer.faults.remaining == 0, "all faults to be spent")
        made.await_rows(10)
        summary = made.finish()
        assert_all_counted_once(made, summary, lost_sweeps=2 * len(LineFault))
        assert summary.acquisition.faults >= 3


def test_a_scenario_that_ends_is_a_fault_and_never_a_repeated_row(caplog: pytest.LogCaptureFixture) -> None:
    with bench() as made:
        made.instrument._source = _Ended()
        wait_until(lambda: made.station.acquisition.counters.faults >= 2, "the end to be noticed")
        rows = made.station.acquisition.counters.rows
        wait_until(lambda: made.station.acquisition.counters.faults >= 4, "the next attempts")
        assert made.station.acquisition.counters.rows == rows
        summary = made.finish()
        assert "scenario has ended" in caplog.text
        assert summary.undelivered == 0


def test_a_held_sweep_is_waited_for_and_a_stop_does_not_wait_for_ever() -> None:
    is_allowed = threading.Event()
    is_allowed.set()
    # a stop waits for the answer in hand so long
    with bench(hold_s=240.0, io_timeout_s=3.0 * SHORT_S) as made:
        made.instrument._may_advance = is_allowed.is_set
        is_allowed.clear()
        wait_until(lambda: made.instrument.is_pending, "a sweep to be held")
        time.sleep(0.7)  # longer than one slice of the wait
        is_allowed.set()
        made.await_rows(10)
        assert made.station.acquisition.counters.faults == 0
        is_allowed.clear()
        wait_until(lambda: made.instrument.is_pending, "a sweep to be held")
        begun_s = time.monotonic()
        summary = made.finish()
        assert time.monotonic() - begun_s < PATIENCE_S  # three seconds and a slice alone; not the whole hold
        assert_all_counted_once(made, summary)


def test_a_peer_that_leaves_during_a_long_wait_is_noticed() -> None:
    with bench(hold_s=240.0) as made:
        begun_s = time.monotonic()
        made.analyzer.faults.arm(LineFault.CLOSE)
        wait_until(lambda: made.station.acquisition.counters.faults >= 1, "the fault to be noticed")
        assert time.monotonic() - begun_s < PATIENCE_S  # a slice of half a second alone; not the whole hold
        made.await_rows(10)


class _Ended:
    """A world after its last row."""

    def advance(self) -> Any:
        raise EndOfScenario

    current = advance


def test_a_service_that_goes_and_comes_back_has_every_row_once(caplog: pytest.LogCaptureFixture) -> None:
    with bench() as made:
        made.recorder.stop()
        wait_until(lambda: made.station.uploader.waiting > 150, "rows to gather")
        assert made.station.uploader.counters.failures >= 1
        made.recorder.start()
        made.await_rows(200)
        summary = made.finish()
        assert_all_counted_once(made, summary)
        assert summary.acquisition.faults == 0
    assert "service does not answer" in caplog.text
    assert "rows wait" in caplog.text


@pytest.mark.parametrize(
    "fault", ["500", "stored_500", "drop", "stored_drop", pytest.param("slow", marks=pytest.mark.slow)]
)
def test_a_service_that_fails_in_the_middle_neither_loses_nor_doubles(fault: str) -> None:
    with bench(service_timeout_s=SHORT_S if fault == "slow" else PATIENCE_S) as made:
        made.recorder.slow_s = 2.0 * SHORT_S
        made.recorder.faults += [fault] * 2
        wait_until(lambda: not made.recorder.faults, f"{fault} to happen")
        made.await_rows(30)
        summary = made.finish()
        assert_all_counted_once(made, summary)
        assert summary.upload.failures >= 2
        if fault.startswith("stored"):
            assert made.recorder.duplicates >= 1


def test_a_stop_without_a_service_says_what_was_left() -> None:
    with bench(drain_s=0.2) as made:
        made.recorder.stop()
        wait_until(lambda: made.station.uploader.waiting > 5, "rows to gather")
        summary = made.finish()
        assert summary.undelivered == summary.acquisition.rows - len(made.recorder.rows)
        assert summary.undelivered > 0
