"""Rows of what is read from a sweep: the format of numbers, traces, the power of a channel.

Law of this file: a format is a row of :class:`TraceFormat`; which bytes it makes is the business of ``levels.py``. A
number of the channel power out of range is stored at its limit and then reported as -222.
"""

import math
from collections.abc import Callable, Mapping

import numpy as np

from analyzer_sim.dialects.dialect import Call, Command, Reader, TraceStyle
from analyzer_sim.dialects.settings_rows import number_text
from analyzer_sim.instrument.channel_power import Band, ChannelSettings, band_power_mw, decibels
from analyzer_sim.instrument.levels import ENCODERS, UNITS, FloatArray, ascii_list, definite_block
from analyzer_sim.instrument.models import Limits
from analyzer_sim.instrument.spectrum import SweepGrid
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import HERTZ, PURE, Boolean, Choice, Numeric, Parameter
from analyzer_sim.scpi.parser import short_form

#: not a number, as SCPI-99 writes it (7.2.1.5)
NOT_A_NUMBER = "9.91E37"
#: header below the one of the channel power -> which of power and density it answers
_CHANNEL_RESULTS = {"": slice(0, 2), ":CHPower": slice(0, 1), ":DENSity": slice(1, 2)}


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


def channel_row(
    pattern: str,
    name: str,
    limits: Limits,
    units: Mapping[str, float] = HERTZ,
    *,
    reshapes: bool = False,
    is_whole: bool = False,
) -> Command:
    """Return the row of a number of ``ChannelSettings`` with its MIN MAX DEF; ``reshapes`` makes the trace stale."""
    words = {"MIN": limits.low, "MAX": limits.high, "DEF": limits.default}

    def write(call: Call, value: float | str) -> None:
        if isinstance(value, str) and value not in words:
            raise ScpiError(-141, value)
        number = words[value] if isinstance(value, str) else value
        clamped = min(max(number, limits.low), limits.high)
        setattr(call.instrument.channel, name, float(round(clamped)) if is_whole else clamped)
        if reshapes:
            call.instrument.invalidate()
        if clamped != number:
            raise ScpiError(-222, f"{number:g}")

    def query(call: Call, value: float | str = "") -> str:
        if not isinstance(value, str):
            raise ScpiError(-128)
        return number_text(words[value] if value in words else getattr(call.instrument.channel, name))

    return Command(pattern, write, query, (Numeric(units),), query_parameters=(Numeric(units),))


def channel_switch_row(pattern: str, name: str, *, reshapes: bool = False) -> Command:
    """Return the row of a switch of ``ChannelSettings``."""

    def write(call: Call, is_on: bool) -> None:  # noqa: FBT001 - the one value of the command
        setattr(call.instrument.channel, name, is_on)
        if reshapes:
            call.instrument.invalidate()

    return Command(pattern, write, lambda call: str(int(getattr(call.instrument.channel, name))), (Boolean(),))


def channel_power_rows(
    head: str, answer: Callable[[Call, slice], str], starts: Callable[[Call], None] | None = None
) -> tuple[Command, ...]:
    """Return the rows that answer power and density of the channel, together and alone."""

    def query(which: slice) -> Reader:
        return lambda call: answer(call, which)

    return tuple(
        Command(f"{head}{part}", query=query(which), query_waits=True, query_starts=starts)
        for part, which in _CHANNEL_RESULTS.items()
    )


def channel_power(call: Call) -> tuple[float, ...]:
    """Return the power in the channel about the centre of the trace and its density, in the unit of the display.

    Raises
    ------
    ScpiError
        -221 in zero span, -230 when no sweep has been taken with the present settings.
    """
    trace = call.instrument.trace()
    grid = trace.grid
    if grid.spacing_hz <= 0.0:
        raise ScpiError(-221, "zero span")
    band = Band(0.5 * (grid.start_hz + grid.stop_hz), call.instrument.channel.width_hz or grid.stop_hz - grid.start_hz)
    power_dbm = decibels(band_power_mw(trace.level_dbm, grid, band))
    levels_dbm = np.array([power_dbm, power_dbm - decibels(band.width_hz)])
    return tuple(UNITS[call.instrument.settings.unit](levels_dbm).tolist())


def results_text(values: tuple[float, ...], missing: str = NOT_A_NUMBER) -> str:
    """Return results, comma separated.

    Examples
    --------
    >>> results_text((-40.125, float("nan"), 1.0e9))
    '-40.125,9.91E37,1000000000'
    """
    return ",".join(number_text(value) if math.isfinite(value) else missing for value in values)


def reset_channel(call: Call) -> ChannelSettings:
    """Return the channel power to its defaults."""
    call.instrument.channel = ChannelSettings(call.instrument.model.channel_width_hz.default)
    return call.instrument.channel


def start_sweep(call: Call) -> None:
    """Start a single sweep; an instrument that sweeps continuously needs none."""
    if not call.instrument.settings.is_continuous:
        call.instrument.initiate()
