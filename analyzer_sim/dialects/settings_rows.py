"""Rows of settings and traces that several dialects share."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from analyzer_sim.dialects.dialect import Call, Command, Reader, TraceStyle
from analyzer_sim.instrument.channel_power import Band, ChannelSettings, band_power_mw, decibels
from analyzer_sim.instrument.instrument_settings import Limits, Settings
from analyzer_sim.instrument.levels import ENCODERS, UNITS, ascii_list, definite_block
from analyzer_sim.instrument.quantities import QUANTITIES, load, shown_limits, store
from analyzer_sim.instrument.spectrum import SweepGrid
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import DECIBELS, HERTZ, PURE, SECONDS, Boolean, Choice, Level, Numeric, Parameter
from analyzer_sim.scpi.parser import short_form
from analyzer_sim.streams import FloatArray


def number_text(value: float) -> str:
    """Return a setting as text, without unit.

    Examples
    --------
    >>> number_text(1.017e9), number_text(0.2), number_text(2401)
    ('1017000000', '0.2', '2401')
    """
    return f"{value:.12g}"


def _word_value(settings: Settings, name: str, word: str) -> float:
    limits = shown_limits(settings, name)
    words = {"MIN": limits.low, "MAX": limits.high, "DEF": limits.default}
    if word in words:
        return words[word]
    return load(settings, name) + QUANTITIES[name].step(settings, 1 if word == "UP" else -1)


def numeric(
    pattern: str, name: str, units: Mapping[str, float] = PURE, *, parameter: Parameter | None = None
) -> Command:
    """Return the row of a numeric setting with its MIN MAX DEF UP DOWN; ``parameter`` where units are not factors."""
    kind = parameter or Numeric(units)

    def write(call: Call, value: float | str) -> None:
        settings = call.instrument.settings
        wanted = _word_value(settings, name, value) if isinstance(value, str) else value
        is_clamped = store(settings, name, wanted)
        call.instrument.invalidate()
        if is_clamped:
            raise ScpiError(-222, f"{wanted:g}")

    def query(call: Call, value: float | str = "") -> str:
        settings = call.instrument.settings
        if not isinstance(value, str):
            raise ScpiError(-128)
        return number_text(_word_value(settings, name, value) if value else load(settings, name))

    return Command(pattern, write, query, (kind,), query_parameters=(kind,))


def switch(pattern: str, write: Callable[[Call, bool], None], is_on: Callable[[Call], bool]) -> Command:
    """Return the row of a switch, which is answered as 1 or 0."""
    return Command(pattern, write, lambda call: str(int(is_on(call))), (Boolean(),))


def boolean(pattern: str, attribute: str, frozen: tuple[str, str] | None = None) -> Command:
    """Return the row of a switch; ``frozen``: what is chosen when a coupling is switched off, and what was in force."""

    def write(call: Call, value: bool) -> None:  # noqa: FBT001 - the one value of the command
        settings = call.instrument.settings
        if frozen is not None and not value:
            setattr(settings, frozen[0], getattr(settings, frozen[1]))
        setattr(settings, attribute, value)
        call.instrument.invalidate()

    return switch(pattern, write, lambda call: getattr(call.instrument.settings, attribute))


def choice(pattern: str, attribute: str, words: tuple[str, ...], *, is_display: bool = False) -> Command:
    """Return the row of a word out of a list; ``is_display`` marks what leaves the trace valid."""

    def write(call: Call, value: str) -> None:
        setattr(call.instrument.settings, attribute, value)
        if not is_display:
            call.instrument.invalidate()

    def query(call: Call) -> str:
        return str(getattr(call.instrument.settings, attribute))

    return Command(pattern, write, query, (Choice(words),))


def inert(pattern: str, default: str, words: tuple[str, ...] = ()) -> Command:
    """Return the row of a setting that is remembered and answered but changes nothing.

    Without ``words`` it is a switch.
    """

    def write(call: Call, value: str | bool) -> None:  # noqa: FBT001 - the one value of the command
        call.instrument.settings.inert[pattern] = str(int(value)) if isinstance(value, bool) else value

    def query(call: Call) -> str:
        return call.instrument.settings.inert.get(pattern, default)

    return Command(pattern, write, query, (Choice(words) if words else Boolean(),), is_inert=True)


def inert_number(pattern: str, default: float, low: float, high: float, units: Mapping[str, float] = PURE) -> Command:
    """Return the row of a number that is remembered and answered but changes nothing."""

    def put(call: Call, value: float) -> None:
        call.instrument.settings.inert[pattern] = number_text(value)

    def read(call: Call) -> float:
        return float(call.instrument.settings.inert.get(pattern, default))

    return replace(_bounded(pattern, Limits(low, high, default), units, -224, (put, read)), is_inert=True)


def _bounded(
    pattern: str,
    limits: Limits,
    units: Mapping[str, float],
    unknown: int,
    access: tuple[Callable[[Call, float], None], Callable[[Call], float]],
) -> Command:
    """Return the row of a number within limits, with its MIN MAX DEF; `unknown` is the error of another word."""
    words = {"MIN": limits.low, "MAX": limits.high, "DEF": limits.default}
    put, read = access

    def wanted(value: float | str) -> float:
        if isinstance(value, str) and value not in words:
            raise ScpiError(unknown, value)
        return words[value] if isinstance(value, str) else value

    def write(call: Call, value: float | str) -> None:
        number = wanted(value)
        clamped = min(max(number, limits.low), limits.high)
        put(call, clamped)
        if clamped != number:
            raise ScpiError(-222, f"{number:g}")

    def query(call: Call, value: float | str = "") -> str:
        if not isinstance(value, str):
            raise ScpiError(-128)
        return number_text(wanted(value) if value else read(call))

    return Command(pattern, write, query, (Numeric(units),), query_parameters=(Numeric(units),))


def constant(pattern: str, answer: str) -> Command:
    """Return the row of a query whose answer never changes."""
    return Command(pattern, query=lambda _call: answer)


def ignored(pattern: str) -> Command:
    """Return the row of a command that is accepted and does nothing."""
    return Command(pattern, lambda _call: None, is_inert=True)


def frequency_rows(head: str, step: str) -> tuple[Command, ...]:
    """Return the rows of centre and its step, span, ends and offset."""
    settings = {"CENTer": "center_hz", step: "step_hz", "SPAN": "span_hz", "STARt": "start_hz", "STOP": "stop_hz"}
    settings["OFFSet"] = "offset_hz"
    rows = (numeric(f"{head}:{word}", name, HERTZ) for word, name in settings.items())
    return (*rows, span_row(f"{head}:SPAN:FULL", lambda settings: settings.model.max_frequency_hz))


def bandwidth_rows(head: str) -> tuple[Command, ...]:
    """Return the rows of the filters and their couplings."""
    return (
        numeric(f"{head}[:RESolution]", "rbw_hz", HERTZ),
        boolean(f"{head}[:RESolution]:AUTO", "is_rbw_auto", ("rbw_chosen_hz", "rbw_shown_hz")),
        numeric(f"{head}:VIDeo", "vbw_hz", HERTZ),
        numeric(f"{head}:VIDeo:RATio", "vbw_per_rbw"),
        boolean(f"{head}:VIDeo:AUTO", "is_vbw_auto", ("vbw_chosen_hz", "vbw_hz")),
    )


def sweep_time_rows(head: str) -> tuple[Command, ...]:
    """Return the rows of the sweep time and its coupling."""
    return (
        numeric(f"{head}:TIME", "time_s", SECONDS),
        boolean(f"{head}:TIME:AUTO", "is_time_auto", ("time_chosen_s", "time_s")),
    )


def level_rows(scale: str, attenuation: str, preamplifier: str) -> tuple[Command, ...]:
    """Return the rows of the reference level, its offset, attenuator and preamplifier."""
    return (
        numeric(f"{scale}:RLEVel", "reference_dbm", parameter=Level()),
        numeric(f"{scale}:RLEVel:OFFSet", "level_offset_db", DECIBELS),
        numeric(attenuation, "attenuation_db", DECIBELS),
        boolean(f"{attenuation}:AUTO", "is_attenuation_auto", ("attenuation_chosen_db", "attenuation_db")),
        boolean(preamplifier, "is_preamplifier_on"),
    )


def step_auto_row(pattern: str) -> Command:
    """Return the row that couples the step of the centre to the span."""

    def write(call: Call, is_auto: bool) -> None:  # noqa: FBT001 - the one value of the command
        settings = call.instrument.settings
        settings.step_chosen_hz = None if is_auto else settings.step_hz

    return switch(pattern, write, lambda call: call.instrument.settings.step_chosen_hz is None)


def span_row(pattern: str, width: Callable[[Settings], float | None]) -> Command:
    """Return the row of a command that sets the span to a width within its limits; None leaves it."""

    def write(call: Call) -> None:
        width_hz = width(call.instrument.settings)
        if width_hz is not None:
            store(call.instrument.settings, "span_hz", width_hz)
            call.instrument.invalidate()

    return Command(pattern, write)


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

    def put(call: Call, value: float) -> None:
        setattr(call.instrument.channel, name, float(round(value)) if is_whole else value)
        if reshapes:
            call.instrument.invalidate()

    return _bounded(pattern, limits, units, -141, (put, lambda call: getattr(call.instrument.channel, name)))


def channel_switch_row(pattern: str, name: str, *, reshapes: bool = False) -> Command:
    """Return the row of a switch of ``ChannelSettings``."""

    def write(call: Call, is_on: bool) -> None:  # noqa: FBT001 - the one value of the command
        setattr(call.instrument.channel, name, is_on)
        if reshapes:
            call.instrument.invalidate()

    return switch(pattern, write, lambda call: getattr(call.instrument.channel, name))


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
