"""Dialect of one maker's analyzer as data: rows of commands, style of traces, start-up settings, peculiarities.

Law of this file: a dialect is rows of :class:`Command`; the session knows nothing else of it. A handler takes the call
and its values and returns the response text, or ``None`` for a command; it fails with :class:`ScpiError`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from analyzer_sim.instrument.imperfections import Imperfections
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.instrument_settings import AnalyzerModel
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import Parameter
from analyzer_sim.scpi.parser import Unit, parse_data, short_form


class Call(NamedTuple):
    """Arguments of a command handler."""

    instrument: Instrument
    #: an earlier unit of the same message has answered
    has_response: bool
    #: mnemonics of the whole header, as they were sent; upper case
    header: tuple[str, ...] = ()

    def suffix(self, pattern: str) -> int:
        """Return the number behind a mnemonic of the header, 1 when none stands there.

        Examples
        --------
        >>> Call(None, False, ("CALC", "MARK3", "Y")).suffix("MARKer")
        3
        """
        names = {pattern.upper(), short_form(pattern)}
        for node in self.header:
            name = node.rstrip("0123456789")
            if name in names:
                return int(node[len(name) :] or 1)
        return 1


Writer = Callable[..., None]
Reader = Callable[..., str | bytes]


@dataclass(frozen=True, slots=True)
class Command:
    """One row: a header and what its command and its query do."""

    #: header as manuals write it, see ``scpi/tree.py``
    pattern: str
    #: what the command does; ``None`` = there is only a query
    write: Writer | None = None
    #: what the query answers; ``None`` = there is only a command
    query: Reader | None = None
    #: parameters of the command; the last ``optional`` of them may be left out
    parameters: tuple[Parameter, ...] = ()
    optional: int = 0
    #: parameters of the query; those after the first ``query_required`` may be left out
    query_parameters: tuple[Parameter, ...] = ()
    query_required: int = 0
    #: the command, or the query, is held until no sweep is pending
    write_waits: bool = False
    query_waits: bool = False
    #: what the query does once, before it waits, with the parameters of the query: READ and MEASure start a sweep
    query_starts: Writer | None = None
    #: it is accepted and answered and changes nothing
    is_inert: bool = False

    def waits(self, unit: Unit) -> bool:
        """Tell whether this unit is held while a sweep is pending."""
        return self.query_waits if unit.is_query else self.write_waits

    def starts(self, unit: Unit) -> bool:
        """Tell whether this unit starts a sweep before it waits for it."""
        return unit.is_query and self.query_starts is not None

    def start(self, unit: Unit, call: Call) -> None:
        """Start the sweep of a query that needs one; errors as of :meth:`run`."""
        if self.query_starts is not None:
            self.query_starts(call, *self._values(unit))

    def run(self, unit: Unit, call: Call) -> str | bytes | None:
        """Execute one unit.

        Raises
        ------
        ScpiError
            -113 the header has no such form, -108 -109 wrong number of parameters, and whatever the handler finds.
        """
        handler: Callable[..., Any] | None = self.query if unit.is_query else self.write
        if handler is None:
            raise ScpiError(-113, unit.header)
        answer: str | bytes | None = handler(call, *self._values(unit))
        return answer

    def _values(self, unit: Unit) -> list[object]:
        parameters = self.query_parameters if unit.is_query else self.parameters
        required = self.query_required if unit.is_query else len(self.parameters) - self.optional
        data = parse_data(unit.data)
        if len(data) > len(parameters):
            raise ScpiError(-108, unit.header)
        if len(data) < required:
            raise ScpiError(-109, unit.header)
        return [parameter.read(datum) for parameter, datum in zip(parameters, data, strict=False)]


@dataclass(frozen=True, slots=True)
class TraceFormat:
    """One format of numbers that ``FORMat`` knows."""

    #: word and length as the command takes them; of several lengths of a word the first row holds when none is given
    word: str
    length: int
    #: answer to ``FORMat?``
    answer: str
    #: what is stored in ``Settings.data_format``: ASC or a key of ``levels.ENCODERS``
    key: str


@dataclass(frozen=True, slots=True)
class TraceStyle:
    """Format of a dialect's traces."""

    formats: tuple[TraceFormat, ...]
    #: what stands after the last number of an ASCII trace
    ascii_end: str = ""
    #: an ASCII trace stands in a block of definite length
    is_ascii_in_block: bool = False
    #: answer when there is no valid trace; empty = none, and -230 is queued
    invalid: bytes = b""


@dataclass(frozen=True, slots=True)
class Dialect:
    """One maker's language.

    A new dialect is a module with a table of rows and one ``Dialect``, entered in ``dialects.py``.
    """

    #: name on the command line
    name: str
    #: answer to ``*IDN?``
    identity: str
    #: figures and state after a reset
    model: AnalyzerModel
    #: how traces are written
    traces: TraceStyle
    #: units of levels
    units: tuple[str, ...]
    #: rows of this dialect beside the common commands
    commands: tuple[Command, ...]
    #: messages that the raw socket takes for the interface and the parser never sees
    interface_messages: frozenset[bytes] = frozenset()
    #: relative headers that miss their path are looked up from the root
    is_lenient: bool = False
    #: noise the analyzer adds at 0 dB attenuation, preamplifier off, dBm/Hz
    own_noise_dbm_hz: float = -150.0

    #: where it differs from the real instruments on purpose, a sentence each
    deviations: tuple[str, ...] = ()

    @property
    def imperfections(self) -> Imperfections:
        """The default figures of this make's errors."""
        return replace(Imperfections(), own_noise_dbm_hz=self.own_noise_dbm_hz)
