"""Raw TCP server of the instrument: several sessions, one event loop. No SCPI is known here.

Bytes go to a framer, messages to a session, responses back to the stream, in order, one message at a time. While a
sweep waits for permission the sessions that need it are held; the others are served.
"""

import asyncio
import socket
import struct
import threading
from collections.abc import Awaitable, Callable
from types import TracebackType

from analyzer_sim.dialect import Dialect
from analyzer_sim.dialect_rs import RS
from analyzer_sim.instrument import Instrument
from analyzer_sim.line_faults import GARBAGE_BYTES, LineFault, LineFaults
from analyzer_sim.scpi import MessageFramer, ProgramMessage
from analyzer_sim.session import Session, command_tree

_READ_BYTES = 1 << 16
#: how often a permission that nobody announces is asked for, s
_PERMISSION_POLL_S = 0.005
#: longest wait for the server thread to come up or to end, s
_THREAD_PATIENCE_S = 10.0


class _LineEndedError(Exception):
    """A fault has ended the connection."""


async def _poll() -> None:
    await asyncio.sleep(_PERMISSION_POLL_S)


class SimulatedAnalyzer:
    """The instrument on a TCP port; an asynchronous context manager.

    Parameters
    ----------
    instrument : Instrument
        Shared by all sessions.
    dialect : Dialect
        The language spoken.
    faults : LineFaults, optional
        Faults of the line, for tests of clients.
    permission : callable, optional
        Returns when it is worth asking again whether the next row may be swept; polling when left out.
    host, port
        Where to listen; port 0 takes a free one.
    """

    def __init__(
        self,
        instrument: Instrument,
        dialect: Dialect = RS,
        *,
        faults: LineFaults | None = None,
        permission: Callable[[], Awaitable[None]] = _poll,
        host: str = "127.0.0.1",
        port: int = 0,
    ) -> None:
        self.faults = faults or LineFaults()
        self._instrument = instrument
        self._dialect = dialect
        self._tree = command_tree(dialect)
        self._permission = permission
        self._host = host
        self._wanted_port = port
        self._server: asyncio.Server | None = None
        self._idle = asyncio.Event()
        self._pump: asyncio.Task[None] | None = None
        self._connections: set[asyncio.Task[None]] = set()

    @property
    def port(self) -> int:
        """The port taken; only while the server runs."""
        if self._server is None:
            raise RuntimeError("the server does not run")
        return int(self._server.sockets[0].getsockname()[1])

    async def __aenter__(self) -> "SimulatedAnalyzer":
        self._server = await asyncio.start_server(self._serve, self._host, self._wanted_port)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._server is not None:
            self._server.close()
        tasks = [*self._connections, *([self._pump] if self._pump else [])]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self._server = None

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection until either side ends it."""
        task = asyncio.current_task()
        if task is not None:
            self._connections.add(task)
            task.add_done_callback(self._connections.discard)
        try:
            await self._converse(reader, writer)
        except (ConnectionError, _LineEndedError):
            pass  # the client left or a fault ended the line: either way this session is over
        except asyncio.CancelledError:
            writer.transport.abort()  # the server stops; asyncio wants this task to end without an exception
        finally:
            writer.close()

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        framer = MessageFramer()
        session = Session(self._instrument, self._dialect, self._tree)
        while data := await reader.read(_READ_BYTES):
            for message in framer.feed(data):
                response = await self._execute(session, message)
                if response is not None:
                    await self._send(writer, response)

    async def _execute(self, session: Session, message: ProgramMessage) -> bytes | None:
        """Run one message to its end, waiting where the session is held."""
        session.submit(message)
        while True:
            response = session.run()
            self._watch_pending()
            if session.is_held:
                await self._idle.wait()
            elif session.is_busy:
                await asyncio.sleep(0)
            else:
                return response

    def _watch_pending(self) -> None:
        """Keep the idle event true to the instrument; start the pump when a sweep has become pending."""
        if not self._instrument.is_pending:
            self._idle.set()
            return
        self._idle.clear()
        if self._pump is None or self._pump.done():
            self._pump = asyncio.create_task(self._complete_pending())

    async def _complete_pending(self) -> None:
        """Ask for permission until the pending sweep has run or was aborted."""
        while not self._instrument.complete_pending():
            await self._permission()
        self._idle.set()

    async def _send(self, writer: asyncio.StreamWriter, response: bytes) -> None:
        fault = self.faults.take(response)
        if fault is None:
            writer.write(response)
            await writer.drain()
            return
        writer.write(_spoiled(fault, response))
        await writer.drain()
        if fault in {LineFault.RESET, LineFault.RESET_IN_BLOCK}:
            _reset(writer)
        if fault in {LineFault.RESET, LineFault.RESET_IN_BLOCK, LineFault.CLOSE}:
            raise _LineEndedError


def _spoiled(fault: LineFault, response: bytes) -> bytes:
    """Return what is sent in place of a response."""
    if fault in {LineFault.RESET_IN_BLOCK, LineFault.HALF_BLOCK}:
        return response[: len(response) // 2]
    return GARBAGE_BYTES if fault is LineFault.GARBAGE else b""


def _reset(writer: asyncio.StreamWriter) -> None:
    """Make closing send RST: the peer's next read or write fails at once."""
    line: socket.socket = writer.get_extra_info("socket")
    line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


class AnalyzerThread:
    """A simulated analyzer served from a thread of its own; made by :func:`start_in_thread`."""

    def __init__(self, instrument: Instrument, dialect: Dialect, port: int, faults: LineFaults) -> None:
        self.instrument = instrument
        self.faults = faults
        #: the port taken
        self.port = port
        self._dialect = dialect
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
        async with SimulatedAnalyzer(self.instrument, self._dialect, faults=self.faults, port=self.port) as analyzer:
            self.port = analyzer.port
            self._is_up.set()
            await self._stop_wanted.wait()


def start_in_thread(
    instrument: Instrument, port: int = 0, faults: LineFaults | None = None, dialect: Dialect = RS
) -> AnalyzerThread:
    """Serve an instrument on 127.0.0.1 from a thread; use the handle as a context manager or call its ``stop``.

    Raises
    ------
    OSError
        The port is taken.
    """
    handle = AnalyzerThread(instrument, dialect, port, faults or LineFaults())
    handle.start()
    return handle
