"""A session to an analyzer: what hangs can be cut, who leaves is noticed at once, nothing keeps the processor busy."""

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from analyzer_thread import AnalyzerThread, start_in_thread
from steady_world import Steady, steady_task

from analyzer_sim.instrument.imperfections import IDEAL
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import Detail, TracePainter
from analyzer_sim.lines.line_faults import LineFault
from service.client.backoff import Backoff
from service.frontend.acquisition.acquisition import Acquisition
from service.frontend.acquisition.settings import AcquisitionSettings
from service.frontend.drivers.visa_session import AnalyzerIOError, VisaSession

pytestmark = pytest.mark.system

#: longer than any of these tests may wait
PATIENCE_S = 240.0


@pytest.fixture
def analyzer() -> Iterator[AnalyzerThread]:
    """Give a simulated analyzer on both transports."""
    with start_in_thread(Instrument(Steady(), TracePainter(1)), hislip_port=0) as made:
        yield made


@pytest.fixture(params=["socket", "hislip"])
def session(request: pytest.FixtureRequest, analyzer: AnalyzerThread) -> Iterator[VisaSession]:
    """Give a session that has been answered once."""
    name = f"{analyzer.port}::SOCKET" if request.param == "socket" else f"hislip0,{analyzer.hislip_port}::INSTR"
    made = VisaSession(f"TCPIP::127.0.0.1::{name}", PATIENCE_S)
    assert made.query("*IDN?").startswith("Rohde&Schwarz")
    yield made
    made.close()


def test_a_call_that_hangs_returns_when_its_line_is_cut(analyzer: AnalyzerThread, session: VisaSession) -> None:
    analyzer.faults.is_silent_peer = True
    begun_s, busy_s = time.monotonic(), time.process_time()
    cut = threading.Timer(0.3, session.abandon)
    cut.start()
    with pytest.raises(AnalyzerIOError):
        session.query("*IDN?")
    cut.join()
    # without the cut it would be four minutes
    assert time.monotonic() - begun_s < 120.0
    assert time.process_time() - busy_s < 1.0


def test_a_peer_that_leaves_is_noticed_at_once(analyzer: AnalyzerThread, session: VisaSession) -> None:
    analyzer.faults.arm(LineFault.CLOSE)
    begun_s = time.monotonic()
    with pytest.raises(AnalyzerIOError):
        session.query("*IDN?")
    assert time.monotonic() - begun_s < 120.0  # as above


def test_a_silent_peer_is_waited_for_as_long_as_allowed_without_work(
    analyzer: AnalyzerThread, session: VisaSession
) -> None:
    analyzer.faults.is_silent_peer = True
    begun_s, busy_s = time.monotonic(), time.process_time()
    with pytest.raises(AnalyzerIOError, match="does not answer"):
        session.query("*IDN?", 2.0)
    waited_s = time.monotonic() - begun_s
    assert 1.9 < waited_s < 120.0
    # server and client share the process; circling would take all of the time
    assert time.process_time() - busy_s < 0.5 * waited_s


class _Measuring:
    """An acquisition in a thread, and how many rows it gave."""

    def __init__(self, port: int) -> None:
        self.rows = 0
        self._stop = threading.Event()
        settings = AcquisitionSettings(f"TCPIP::127.0.0.1::{port}::SOCKET", 0.1, io_timeout_s=PATIENCE_S)
        self.acquisition = Acquisition(
            steady_task(time_s=0.05), settings, self._count, lambda: time.monotonic_ns() // 1000, self._stop, Backoff()
        )
        self._thread = threading.Thread(target=self.acquisition.run)
        self._thread.start()

    def _count(self, _: object) -> bool:
        self.rows += 1
        return True

    def await_rows(self, count: int) -> None:
        """Wait for some more rows."""
        until_s, rows = time.monotonic() + PATIENCE_S / 2, self.rows + count
        while self.rows < rows:
            assert time.monotonic() < until_s, f"{self.rows} of {rows} rows"
            time.sleep(0.01)

    def end(self) -> None:
        """Stop it."""
        self._stop.set()
        self._thread.join(PATIENCE_S)


def test_analyzers_of_one_process_go_on_while_one_of_them_hangs() -> None:
    with ExitStack() as stack:
        analyzers = [
            stack.enter_context(start_in_thread(Instrument(Steady(), TracePainter(seed, IDEAL, Detail.FAST))))
            for seed in range(4)
        ]
        measuring = []
        for analyzer in analyzers:
            measuring.append(_Measuring(analyzer.port))
            stack.callback(measuring[-1].end)
        for each in measuring:
            each.await_rows(2)
        # each call to it may take longer than the others are waited for
        analyzers[0].faults.is_silent_peer = True
        before = measuring[0].rows
        for each in measuring[1:]:
            each.await_rows(10)
        assert measuring[0].rows <= before + 1
        assert [each.acquisition.counters.faults for each in measuring] == [0] * 4
        # its line ends, and with it the call that hangs
        analyzers[0].stop()
