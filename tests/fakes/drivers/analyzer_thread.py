"""A simulated analyzer in a thread of the test."""

import asyncio
import threading
from types import TracebackType

from analyzer_sim.dialects.dialect import Dialect
from analyzer_sim.dialects.rs import RS
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.serving import SimulatedAnalyzer

_THREAD_PATIENCE_S = 120.0


class AnalyzerThread:
    """A simulated analyzer served from a thread of its own; made by :func:`start_in_thread`."""

    def __init__(self, analyzer: SimulatedAnalyzer, instrument: Instrument) -> None:
        self.instrument = instrument
        self.faults = analyzer.faults
        self.trace_faults = instrument.trace_faults
        #: the ports taken
        self.port = 0
        self.hislip_port: int | None = None
        self._analyzer = analyzer
        self._is_up = threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop_wanted: asyncio.Event | None = None
        self._failure: OSError | None = None
        self._thread = threading.Thread(target=self._run, name="simulated analyzer", daemon=True)

    def start(self) -> None:
        """Start serving; return when the port is taken."""
        self._thread.start()
        if not self._is_up.wait(_THREAD_PATIENCE_S):
            raise TimeoutError("the simulated analyzer did not come up")
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Close all connections and the port; calling it twice does no harm."""
        if self._loop is not None and self._stop_wanted is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop_wanted.set)
        self._thread.join(_THREAD_PATIENCE_S)

    def __enter__(self) -> "AnalyzerThread":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except OSError as failure:
            self._failure = failure
            self._is_up.set()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._stop_wanted = asyncio.Event()
        async with self._analyzer as analyzer:
            self.port, self.hislip_port = analyzer.port, analyzer.hislip_port
            self._is_up.set()
            await self._stop_wanted.wait()


def start_in_thread(
    instrument: Instrument,
    port: int = 0,
    dialect: Dialect = RS,
    hislip_port: int | None = None,
) -> AnalyzerThread:
    """Serve an instrument on 127.0.0.1 from a thread; use the handle as a context manager or call its ``stop``.

    Raises
    ------
    OSError
        A port is taken.
    """
    analyzer = SimulatedAnalyzer(instrument, dialect, port=port, hislip_port=hislip_port)
    handle = AnalyzerThread(analyzer, instrument)
    handle.start()
    return handle
