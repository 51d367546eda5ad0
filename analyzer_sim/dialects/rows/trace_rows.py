"""Rows for the format of numbers and for reading traces, made from what a dialect says of both.

Law of this file: a format is a row of :class:`TraceFormat`; which bytes it makes is the business of ``levels.py``.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from analyzer_sim.dialects.rows.command_row import Call, Command, Reader
from analyzer_sim.instrument.levels import ENCODERS, UNITS, FloatArray, ascii_list, definite_block
from analyzer_sim.instrument.spectrum import SweepGrid
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import PURE, Choice, Numeric, Parameter
from analyzer_sim.scpi.parser import short_form


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


def format_row(pattern: str, style: TraceStyle) -> Command:
    """Return the row that chooses the format."""

    def write(call: Call, word: str, length: float | str = "") -> None:
        fits = [row for row in style.formats if short_form(row.word) == word and length in {"", float(row.length)}]
        if not fits:
            raise ScpiError(-224, f"{word},{length}")
        call.instrument.settings.data_format = fits[0].key

    def query(call: Call) -> str:
        return next(row.answer for row in style.formats if row.key == call.instrument.settings.data_format)

    words = tuple(dict.fromkeys(row.word for row in style.formats))
    return Command(pattern, write, query, (Choice(words), Numeric(PURE)), optional=1)


def byte_order_row(pattern: str) -> Command:
    """Return the row of the order of bytes in blocks: NORMal is big-endian (SCPI-99, 9.1)."""

    def write(call: Call, word: str) -> None:
        call.instrument.settings.is_big_endian = word == "NORM"

    def query(call: Call) -> str:
        return "NORM" if call.instrument.settings.is_big_endian else "SWAP"

    return Command(pattern, write, query, (Choice(("NORMal", "SWAPped")),))


def encode(call: Call, style: TraceStyle, values: FloatArray) -> str | bytes:
    """Return numbers in the format in force."""
    settings = call.instrument.settings
    if settings.data_format != "ASC":
        return ENCODERS[settings.data_format](values, is_big_endian=settings.is_big_endian)
    text = ascii_list(values) + style.ascii_end
    return definite_block(text.encode("ascii")) if style.is_ascii_in_block else text


def levels_shown(call: Call) -> FloatArray:
    """Return the trace in the unit in force, or fail with -230."""
    return UNITS[call.instrument.settings.unit](call.instrument.trace().level_dbm)


def frequencies_shown(call: Call) -> FloatArray:
    """Return the frequencies of the points, the offset included, Hz; in zero span their times, s."""
    settings = call.instrument.settings
    if not settings.span_hz:
        return np.linspace(0.0, settings.time_s, settings.points)
    grid = SweepGrid(settings.start_hz, settings.stop_hz, settings.points, settings.rbw_hz)
    return np.asarray(grid.frequency_hz + settings.offset_hz)


def pairs_shown(call: Call) -> FloatArray:
    """Return frequency and level of every point, one after the other."""
    return np.column_stack([frequencies_shown(call), levels_shown(call)]).ravel()


def _check_shown(number: int) -> None:
    if number != 1:
        raise ScpiError(-230, f"trace {number} is blank")


def trace_reader(
    style: TraceStyle, values: Callable[[Call], FloatArray] = levels_shown, counted_by: str = ""
) -> Reader:
    """Return the handler of a query of trace 1; the other traces are blank.

    The parameter tells which trace is meant, or the number behind the mnemonic ``counted_by`` of the header.
    """

    def query(call: Call, number: int = 1) -> str | bytes:
        try:
            _check_shown(call.suffix(counted_by) if counted_by else number)
            shown = values(call)
            if values is not frequencies_shown:
                shown = call.instrument.read_out(shown)
            return encode(call, style, shown)
        except ScpiError:
            if not style.invalid:
                raise
            return style.invalid

    return query


def trace_row(pattern: str, style: TraceStyle, name: Parameter) -> Command:
    """Return the row that reads a trace; ``name`` turns what names the trace into its number."""
    reader = trace_reader(style)
    return Command(pattern, query=reader, query_parameters=(name,), query_required=1, query_waits=True)
