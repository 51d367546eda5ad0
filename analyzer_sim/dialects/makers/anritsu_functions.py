"""Anritsu MS2090A and MS27xxT: measurement functions on the trace shown.

The verbs, for each measurement::

    CONFigure   select it, RMS detector, single sweep, its figures to their defaults: a channel as wide as the span
    FETCh?      answer from the trace there is          READ?   sweep, then answer      MEASure?   CONFigure and READ?

A result that does not exist is -999.0; without a trace every result is. ``FETCh:OBWidth?`` answers bandwidth, percent
and decibels down, of which one is set and one is measured.

Deviation from the real instruments, on purpose: peaks are told by their excursion; the threshold in percent of the
display is remembered and changes nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from analyzer_sim.dialects.rows.command_row import Call, Command
from analyzer_sim.dialects.rows.function_rows import (
    PERCENT,
    Figure,
    decibel_row,
    figure_row,
    hertz_row,
    results,
    shown_level,
    start_sweep,
    swept_trace,
    word,
    word_row,
)
from analyzer_sim.dialects.rows.marker_rows import MarkerStyle, marker_of, marker_rows
from analyzer_sim.dialects.rows.settings_rows import number_text, numeric
from analyzer_sim.instrument.functions.band_power import Band, adjacent_powers_mw, band_power_mw, decibels
from analyzer_sim.instrument.functions.function_settings import OFF, SPECTRUM
from analyzer_sim.instrument.functions.occupied_bandwidth import (
    decibels_down,
    occupied_by_level,
    occupied_by_percent,
    percent_inside,
)
from analyzer_sim.instrument.painter import Trace
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import HERTZ, Boolean

_SENSE = "[SENSe]"
_MARKER = "CALCulate:MARKer<12>"
_TOP_HZ = 26.5e9
MISSING = "-999.0"

#: a width or a distance of 0 is the span
CHANNEL = Figure("CHP.channel", 0.0, _TOP_HZ, 0.0)
MAIN = Figure("ACP.main", 0.0, _TOP_HZ, 0.0)
ADJACENT = Figure("ACP.adjacent", 0.0, _TOP_HZ, 0.0)
SPACING = Figure("ACP.spacing", 0.0, _TOP_HZ, 0.0)
OCCUPIED_PERCENT = Figure("OBW.percent", 0.0, 100.0, 99.0)
DECIBELS_DOWN = Figure("OBW.down", 0.0, 100.0, 3.0)
_EXCURSION = Figure("peak excursion", 0.0, 100.0, 6.0)
_THRESHOLD = Figure("peak threshold", 0.0, 100.0, 10.0)

STYLE = MarkerStyle(_MARKER, _EXCURSION, f"{_MARKER}:PEAK:EXCursion", ends_at_edge=True)


@dataclass(frozen=True, slots=True)
class Measurement:
    """One measurement."""

    #: answer of ``CONFigure?`` and beginning of the names of its figures
    name: str
    pattern: str
    measure: Callable[[Call], tuple[float, ...]]
    #: sub-header -> which of the results it answers
    parts: tuple[tuple[str, tuple[int, ...]], ...]
    #: which of them the plain header answers
    whole: tuple[int, ...]


def _width_hz(call: Call, figure: Figure, trace: Trace) -> float:
    return figure.load(call) or trace.grid.stop_hz - trace.grid.start_hz


def _width_row(pattern: str, figure: Figure) -> Command:
    """Return the row of a width or a distance; one that was not set is told as the span."""
    row = hertz_row(pattern, figure)
    return replace(
        row,
        query=lambda call: number_text(figure.load(call) or call.instrument.settings.span_hz),
        query_parameters=(),
    )


def _middle_hz(trace: Trace) -> float:
    return 0.5 * (trace.grid.start_hz + trace.grid.stop_hz)


def _channel_power(call: Call) -> tuple[float, ...]:
    """Return the power in the channel and its density."""
    trace = swept_trace(call)
    width_hz = _width_hz(call, CHANNEL, trace)
    power_dbm = decibels(band_power_mw(trace.level_dbm, trace.grid, Band(_middle_hz(trace), width_hz)))
    return shown_level(call, power_dbm), shown_level(call, power_dbm - decibels(width_hz))


def _adjacent_powers(call: Call) -> tuple[float, ...]:
    """Return the main channel, then the lower and the upper of the adjacent and of the alternate pair."""
    trace = swept_trace(call)
    main, width_hz, spacing_hz = (_width_hz(call, figure, trace) for figure in (MAIN, ADJACENT, SPACING))
    pairs = ((spacing_hz, width_hz), (2.0 * spacing_hz, width_hz))
    powers_mw = adjacent_powers_mw(trace.level_dbm, trace.grid, Band(_middle_hz(trace), main), pairs)
    return tuple(shown_level(call, decibels(power_mw)) for power_mw in powers_mw)


def _occupied(call: Call) -> tuple[float, ...]:
    """Return bandwidth, percent, decibels down, lower and upper edge."""
    trace = swept_trace(call)
    level_dbm, grid, offset_hz = trace.level_dbm, trace.grid, call.instrument.settings.offset_hz
    if word(call, "OBW.method", "PERC") == "PERC":
        percent = OCCUPIED_PERCENT.load(call)
        found = occupied_by_percent(level_dbm, grid, percent)
        down_db = decibels_down(level_dbm, grid, found)
    else:
        down_db = DECIBELS_DOWN.load(call)
        found = occupied_by_level(level_dbm, grid, down_db)
        percent = percent_inside(level_dbm, grid, found)
    return found.bandwidth_hz, percent, down_db, found.low_hz + offset_hz, found.high_hz + offset_hz


MEASUREMENTS = (
    Measurement("CHP", "CHPower", _channel_power, (("CHPower", (0,)), ("DENSity", (1,))), (0, 1)),
    Measurement("ACP", "ACPower", _adjacent_powers, (), (0, 1, 2, 3, 4)),
    Measurement("OBW", "OBWidth", _occupied, (("FREQuency", (3, 4)),), (0, 1, 2)),
)


def select(call: Call, measurement: Measurement) -> None:
    """Select a measurement with its defaults: RMS detector, single sweep."""
    functions, settings = call.instrument.functions, call.instrument.settings
    functions.forget(f"{measurement.name}.")
    functions.select(measurement.name)
    settings.detector, settings.is_detector_auto = "RMS", False
    settings.is_continuous = False
    call.instrument.abort()
    call.instrument.invalidate()


def _verb_rows(measurement: Measurement) -> tuple[Command, ...]:
    """Return the rows of the verbs and of the switch of one measurement."""

    def measure(call: Call) -> None:
        select(call, measurement)
        start_sweep(call)

    def switch(call: Call, is_on: bool) -> None:  # noqa: FBT001 - the one value of the command
        call.instrument.functions.select(measurement.name if is_on else SPECTRUM)

    def is_selected(call: Call) -> str:
        return str(int(call.instrument.functions.measurement == measurement.name))

    return (
        Command(f"CONFigure:{measurement.pattern}", lambda call: select(call, measurement)),
        Command(f"{_SENSE}:{measurement.pattern}:STATe", switch, is_selected, (Boolean(),)),
        *_answer_rows("FETCh", measurement, None),
        *_answer_rows("READ", measurement, start_sweep),
        *_answer_rows("MEASure", measurement, measure),
    )


def _answer_rows(verb: str, measurement: Measurement, starts: Callable[[Call], None] | None) -> tuple[Command, ...]:
    """Return the rows that answer the results of a measurement."""

    def answers(which: tuple[int, ...]) -> Callable[[Call], str]:
        def query(call: Call) -> str:
            try:
                values = measurement.measure(call)
            except ScpiError:
                return ",".join([MISSING] * len(which))
            return results(tuple(values[index] for index in which), MISSING)

        return query

    head = f"{verb}:{measurement.pattern}"
    rows = ((f"{head}<2>", measurement.whole), *((f"{head}<2>:{name}", which) for name, which in measurement.parts))
    return tuple(
        Command(pattern, query=answers(which), query_waits=True, query_starts=starts) for pattern, which in rows
    )


def _peak(call: Call) -> str:
    """Return frequency and level of the highest point."""
    try:
        trace = swept_trace(call)
    except ScpiError:
        return f"{MISSING},{MISSING}"
    point = int(trace.level_dbm.argmax())
    frequency_hz = float(trace.grid.frequency_hz[point]) + call.instrument.settings.offset_hz
    return results((frequency_hz, shown_level(call, float(trace.level_dbm[point]))), MISSING)


def _put_noise(call: Call, is_on: bool) -> None:  # noqa: FBT001 - the one value of the command
    marker_of(call).function = "NOIS" if is_on else OFF
    marker_of(call).is_on |= is_on


#: all rows of this file, for the dialect
FUNCTION_ROWS: tuple[Command, ...] = (
    *marker_rows(STYLE, "[:SET]:CENTer"),
    Command(
        f"{_MARKER}:NOISe[:STATe]", _put_noise, lambda call: str(int(marker_of(call).function == "NOIS")), (Boolean(),)
    ),
    figure_row(f"{_MARKER}:PEAK:THReshold", _THRESHOLD, PERCENT),
    Command("CONFigure", query=lambda call: call.instrument.functions.measurement),
    *(row for measurement in MEASUREMENTS for row in _verb_rows(measurement)),
    _width_row(f"{_SENSE}:CHPower:BANDwidth|BWIDth:INTegration", CHANNEL),
    numeric(f"{_SENSE}:CHPower:FREQuency:SPAN", "span_hz", HERTZ),
    _width_row(f"{_SENSE}:ACPower:BANDwidth|BWIDth:MAIN", MAIN),
    _width_row(f"{_SENSE}:ACPower:BANDwidth|BWIDth:ADJacent", ADJACENT),
    _width_row(f"{_SENSE}:ACPower:SPACing", SPACING),
    _width_row(f"{_SENSE}:ACPower:BANDwidth|BWIDth:SPACing", SPACING),
    word_row(f"{_SENSE}:OBWidth:METHod", "OBW.method", ("PERCent", "XDB"), "PERC"),
    figure_row(f"{_SENSE}:OBWidth:PERCent", OCCUPIED_PERCENT, PERCENT),
    decibel_row(f"{_SENSE}:OBWidth:XDB", DECIBELS_DOWN),
    Command("FETCh:PEAK", query=_peak, query_waits=True),
)
