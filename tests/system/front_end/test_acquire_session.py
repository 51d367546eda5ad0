"""A session to an analyzer: what hangs can be cut, who leaves is noticed at once, nothing keeps the processor busy."""

import threading
import time
from collections.abc import Iterator

import pytest
from analyzer_thread import AnalyzerThread, start_in_thread
from steady_world import Steady

from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import TracePainter
from analyzer_sim.lines.line_faults import LineFault
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
