"""Dialogues of clients with one instrument: program messages in, one at a time, response messages out. No transport."""

import asyncio
from collections import Counter, deque
from collections.abc import Awaitable, Callable
from contextlib import suppress

from analyzer_sim.dialects.dialect import Call, Command, Dialect
from analyzer_sim.instrument.instrument import Instrument, TraceNotReadyError
from analyzer_sim.instrument.truth_log import Reading
from analyzer_sim.lines.hislip_session import LockTable
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.framing import ProgramMessage
from analyzer_sim.scpi.parser import Unit, parse_unit, split_units
from analyzer_sim.scpi.tree import CommandTree

#: units run before the caller gets a turn to serve others
UNITS_PER_RUN = 256
#: largest response of one message; beyond it the client can only be deadlocked, bytes
OUTPUT_LIMIT_BYTES = 16 << 20
#: how a block begins whose end nothing but the end of the response tells (IEEE 488.2, 8.7.10)
_INDEFINITE = b"#0"


class Session:
    """Parser state and output of one connection.

    Parameters
    ----------
    instrument : Instrument
        Shared by all sessions.
    dialect : Dialect
        The language spoken.
    tree : CommandTree
        Built once from the dialect by :func:`command_tree`.
    name : str
        Of the connection, for the truth log.
    """

    def __init__(
        self, instrument: Instrument, dialect: Dialect, tree: CommandTree[Command], name: str = "session"
    ) -> None:
        self._name = name
        self._instrument = instrument
        self._dialect = dialect
        self._tree = tree
        self._units: deque[str] = deque()
        self._path: tuple[str, ...] = ()
        self._answers: list[bytes] = []
        self._answer_bytes = 0
        self._readings: tuple[Reading, ...] = ()
        self._is_held = False
        self._has_started = False
        is_alone = instrument.model.is_error_queue_per_session
        self._errors = instrument.status.new_queue() if is_alone else instrument.status.errors

    @property
    def is_held(self) -> bool:
        """Return whether the session waits for the pending sweep."""
        return self._is_held

    @property
    def is_busy(self) -> bool:
        """Return whether units of the last message are left."""
        return bool(self._units)

    def clear(self) -> None:
        """Device clear (IEEE 488.2, 5.8): drop the message that runs and its answers; the sweep goes on."""
        self._units.clear()
        self._empty()
        self._is_held = False
        self._instrument.forget_completion()

    @property
    def readings(self) -> tuple[Reading, ...]:
        """The traces in the last response."""
        return self._readings

    def report_delivery(self, readings: tuple[Reading, ...]) -> None:
        """Note that a response with these traces has left whole."""
        self._instrument.report_delivery(readings, self._name)

    def push_error(self, code: int, detail: str = "") -> None:
        """Queue an error that the transport has seen."""
        self._instrument.status.errors = self._errors
        self._instrument.status.push_error(code, detail)

    def status_byte(self, *, has_response: bool) -> int:
        """Return the status byte as this session sees it."""
        self._instrument.status.errors = self._errors
        return self._instrument.status.status_byte(has_response=has_response)

    def _empty(self) -> None:
        self._path = ()
        self._answers = []
        self._answer_bytes = 0
        self._readings = ()
        self._has_started = False

    def submit(self, message: ProgramMessage) -> None:
        """Take the next program message; the one before must be finished."""
        self._empty()
        self._instrument.status.errors = self._errors
        if message.is_overrun:
            self._instrument.status.push_error(-223, "program message too long")
        elif message.body.strip() not in self._dialect.interface_messages:
            self._units.extend(split_units(message.body))

    def run(self) -> bytes | None:
        """Run units until the message is finished, held, or a turn is over; return its response when finished."""
        self._is_held = False
        self._instrument.status.errors = self._errors
        for _ in range(UNITS_PER_RUN):
            if not self._units:
                break
            if not self._run_unit(self._units[0]):
                self._is_held = True
                return None
            self._units.popleft()
        if self._units or not self._answers:
            return None
        return b";".join(self._answers) + b"\n"

    def _run_unit(self, text: str) -> bool:
        """Run one unit; return whether it could run."""
        before = self._path
        try:
            unit = parse_unit(text)
            command, path = self._tree.find(unit, self._path)
            self._check_end(unit)
            call = Call(self._instrument, bool(self._answers), (*path, unit.nodes[-1]))
            if self._must_wait(command, unit, call):
                return False
            self._path = path
            self._answer(command, unit, call)
        except TraceNotReadyError:
            self._path = before
            return False
        except ScpiError as error:
            self._instrument.status.push_error(error.code, error.detail)
        self._has_started = False
        return True

    def _check_end(self, unit: Unit) -> None:
        """Refuse a query behind an answer that only the end of the response ends (IEEE 488.2, 6.5.7.4)."""
        if unit.is_query and self._answers and self._answers[-1].startswith(_INDEFINITE):
            raise ScpiError(-440, unit.header)

    def _must_wait(self, command: Command, unit: Unit, call: Call) -> bool:
        """Tell whether the unit is held by a sweep; a query that starts its own is started once."""
        if not command.waits(unit):
            return False
        if command.starts(unit) and not self._has_started and not self._instrument.is_pending:
            command.start(unit, call)
            self._has_started = True
        return self._instrument.is_pending

    def _answer(self, command: Command, unit: Unit, call: Call) -> None:
        self._instrument.measured_readings()
        answer = command.run(unit, call)
        if answer is None:
            return
        self._readings += self._instrument.measured_readings()
        self._answers.append(answer if isinstance(answer, bytes) else answer.encode("ascii"))
        self._answer_bytes += len(self._answers[-1])
        if self._answer_bytes > OUTPUT_LIMIT_BYTES:
            self._units = deque([self._units[0]])  # the unit that runs stays until `run` takes it out
            self._answers, self._readings = [], ()
            raise ScpiError(-430, "the response does not fit the output queue")


def command_tree(dialect: Dialect) -> CommandTree[Command]:
    """Return the tree of a dialect's commands."""
    rows = ((row.pattern, row) for row in dialect.commands)
    return CommandTree(rows, is_lenient=dialect.is_lenient)


#: how often a permission that nobody announces is asked for, s
_PERMISSION_POLL_S = 0.005


async def poll_permission() -> None:
    """Return when it is worth asking again, for a permission that nobody announces."""
    await asyncio.sleep(_PERMISSION_POLL_S)


class Dispatcher:
    """Command execution and locks of one instrument, shared by all its transports.

    Parameters
    ----------
    instrument : Instrument
        Shared by all sessions.
    dialect : Dialect
        The language spoken.
    permission : callable
        Returns when it is worth asking again whether the next row may be swept.

    Attributes
    ----------
    locks : LockTable
        Who may run; a client is its session.
    watchers : set of callables
        Called after every change a client could be told of.
    """

    def __init__(
        self,
        instrument: Instrument,
        dialect: Dialect,
        permission: Callable[[], Awaitable[None]] = poll_permission,
    ) -> None:
        self.locks = LockTable()
        self.watchers: set[Callable[[], None]] = set()
        self.instrument = instrument
        self._dialect = dialect
        self._tree = command_tree(dialect)
        self._permission = permission
        self._changed = asyncio.Event()
        self._changes_seen = 0
        self._changes_settled = 0
        self._sessions: Counter[str] = Counter()
        self._pump: asyncio.Task[None] | None = None

    def new_session(self, transport: str) -> Session:
        """Return the parser and output of a new client."""
        self._sessions[transport] += 1
        return Session(self.instrument, self._dialect, self._tree, f"{transport} {self._sessions[transport]}")

    async def execute(self, session: Session, message: ProgramMessage) -> bytes | None:
        """Run one message to its end, waiting where the session is locked out or held; return its response."""
        while not self.locks.may_run(session):
            await self.change()
        session.submit(message)
        while True:
            response = session.run()
            self.poll()
            if session.is_held:
                await self.change()
            elif session.is_busy:
                await asyncio.sleep(0)
            else:
                return response

    async def change(self) -> None:
        """Return after the next change of sweep or locks."""
        await self._changed.wait()

    def announce(self) -> None:
        """Wake everybody who waits for a change."""
        self._changed.set()
        self._changed = asyncio.Event()

    def leave(self, session: Session) -> None:
        """Take the locks of a client that has left."""
        self.locks.drop(session)
        self.announce()

    def poll(self) -> None:
        """Act on what a turn, or time, may have changed."""
        self.instrument.keep_continuous()
        if self._changes_seen != self.instrument.changes:
            self._changes_seen = self.instrument.changes
            self.announce()
            if self._pump is None:
                self._pump = asyncio.create_task(self._keep_time())
        for watcher in tuple(self.watchers):
            watcher()

    async def _keep_time(self) -> None:
        """Let pending sweeps begin when they are allowed and end when their time is over."""
        while True:
            self.instrument.complete_pending()
            self.poll()
            remaining_s = self.instrument.remaining_s
            if remaining_s is None and self._changes_settled != self.instrument.changes:
                # the first of endless sweeps is over: no change of state, yet somebody may wait for it
                self._changes_settled = self.instrument.changes
                self.announce()
            if self.instrument.is_waiting:
                await self._permission_or_change()
            else:
                with suppress(TimeoutError):
                    async with asyncio.timeout(remaining_s):
                        await self.change()

    async def _permission_or_change(self) -> None:
        """Return when it is worth asking again, or when there is nothing to ask for any more."""
        tasks = [asyncio.ensure_future(wait) for wait in (self._permission(), self.change())]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def close(self) -> None:
        """End what runs in the background."""
        if self._pump is not None:
            self._pump.cancel()
            await asyncio.gather(self._pump, return_exceptions=True)
