"""The instrument on its ports: raw TCP and HiSLIP, several sessions of each, one event loop. No SCPI is known here.

On the raw socket bytes go to a framer, messages to a session, responses back to the stream, in order, one message at a
time; what has been written stays in the stream, whatever the client does next. There is no device clear on it, and no
announcement by mDNS: a client is given the address.
"""

import asyncio
from collections.abc import Awaitable, Callable
from types import TracebackType

from analyzer_sim.dialects.dialect import Dialect
from analyzer_sim.dialects.rs import RS
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.lines.dispatcher import Dispatcher, poll_permission
from analyzer_sim.lines.hislip_server import HislipServer
from analyzer_sim.lines.line_faults import FaultyLine, LineEndedError, LineFaults
from analyzer_sim.scpi.framing import MessageFramer

_READ_BYTES = 1 << 16
#: what a stream buffers before it stops reading from the network; asyncio's own 64 KiB cut long blocks in pieces, bytes
_STREAM_LIMIT_BYTES = 1 << 20

_Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


def port_error(name: str, port: int, host: str, error: OSError) -> OSError:
    """Return what to raise in place of an error of a listening socket: its text names the port."""
    # asyncio puts the address before the reason, since Python 3.13 also the number of the error in brackets
    reason = str(error.strerror or error).rpartition(": ")[2].rpartition("] ")[2].lower()
    return OSError(f"{name} port {port} of {host}: {reason}")


class SimulatedAnalyzer:
    """The instrument on its TCP ports; an asynchronous context manager.

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
    alias_ports : tuple of int
        Further ports of the raw socket.
    hislip_port : int, optional
        Port of HiSLIP, 0 takes a free one; not served when left out.
    """

    def __init__(
        self,
        instrument: Instrument,
        dialect: Dialect = RS,
        *,
        faults: LineFaults | None = None,
        permission: Callable[[], Awaitable[None]] = poll_permission,
        host: str = "127.0.0.1",
        port: int = 0,
        alias_ports: tuple[int, ...] = (),
        hislip_port: int | None = None,
    ) -> None:
        self.faults = faults or LineFaults()
        self._dispatcher = Dispatcher(instrument, dialect, permission)
        self._hislip = HislipServer(self._dispatcher, self.faults)
        self._host = host
        self._raw_ports = (port, *alias_ports)
        self._wanted_hislip_port = hislip_port
        self._servers: list[asyncio.Server] = []
        self._connections: set[asyncio.Task[None]] = set()

    @property
    def port(self) -> int:
        """The port taken by the raw socket; only while the server runs."""
        return self._port_of(0)

    @property
    def alias_ports(self) -> tuple[int, ...]:
        """The further ports taken by the raw socket."""
        return tuple(self._port_of(number) for number in range(1, len(self._raw_ports)))

    @property
    def hislip_port(self) -> int | None:
        """The port taken by HiSLIP, if it is served."""
        return None if self._wanted_hislip_port is None else self._port_of(-1)

    def _port_of(self, number: int) -> int:
        if not self._servers:
            raise RuntimeError("the server does not run")
        return int(self._servers[number].sockets[0].getsockname()[1])

    async def __aenter__(self) -> "SimulatedAnalyzer":
        try:
            for port in self._raw_ports:
                await self._listen("SCPI", port, self._converse)
            if self._wanted_hislip_port is not None:
                await self._listen("HiSLIP", self._wanted_hislip_port, self._hislip.serve)
        except OSError:
            await self._stop()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._stop()

    async def _listen(self, name: str, port: int, serve: _Serve) -> None:
        """Open a port.

        Raises
        ------
        OSError
            It cannot be had; the text names it.
        """

        async def on_connection(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await self._serve(serve, reader, writer)

        try:
            server = await asyncio.start_server(on_connection, self._host, port, limit=_STREAM_LIMIT_BYTES)
        except OSError as error:
            raise port_error(name, port, self._host, error) from error
        self._servers.append(server)

    async def _stop(self) -> None:
        for server in self._servers:
            server.close()
        self._servers = []
        connections = tuple(self._connections)
        for task in connections:
            task.cancel()
        await asyncio.gather(*connections, return_exceptions=True)
        await self._dispatcher.close()

    async def _serve(self, serve: _Serve, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection until either side ends it."""
        task = asyncio.current_task()
        if task is not None:
            self._connections.add(task)
            task.add_done_callback(self._connections.discard)
        try:
            await serve(reader, writer)
        except (ConnectionError, LineEndedError):
            pass  # the client left or a fault ended the line: either way this session is over
        except asyncio.CancelledError:
            writer.transport.abort()  # the server stops; asyncio wants this task to end without an exception
        finally:
            writer.close()

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a connection of the raw socket."""
        framer, line = MessageFramer(), FaultyLine(writer, self.faults)
        session = self._dispatcher.new_session("socket")
        try:
            while data := await reader.read(_READ_BYTES):
                for message in framer.feed(data):
                    response = await self._dispatcher.execute(session, message)
                    if response is not None and await line.send(response, (response,)):
                        session.report_delivery(session.readings)
        finally:
            self._dispatcher.leave(session)
