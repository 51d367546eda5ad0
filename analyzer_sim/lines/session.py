"""One client's dialogue: program messages in, response messages out. No socket, no waiting.

Law of this file: a failed unit is queued and answers nothing; the others of its message still run; all answers of a
message make one response. When a unit is held (``*OPC?``, ``*WAI``, a trace query while a sweep is pending) the session
stops there and :meth:`Session.run` goes on from the same unit when it is called again.
"""

from collections import deque

from analyzer_sim.dialects.dialect import Call, Command, Dialect
from analyzer_sim.instrument.instrument import Instrument, TraceNotReadyError
from analyzer_sim.instrument.truth_log import Reading
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
