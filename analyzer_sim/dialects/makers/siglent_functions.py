"""Siglent SSA3000X: measurement functions on the trace shown.

``MEASure`` answers from the trace there is; a sweep is taken first only when the settings have changed since and the
instrument does not sweep without end [K]. A channel is centred; ``CHPower:FREQuency:SPAN:POWer`` makes it as wide as
the span.
"""

from collections.abc import Callable

from analyzer_sim.dialects.rows.command_row import Call, Command
from analyzer_sim.dialects.rows.function_rows import (
    PERCENT,
    Figure,
    decibel_row,
    figure_row,
    hertz_row,
    middle_band,
    results,
    shown_level,
    start_if_stale,
    swept_trace,
    word,
    word_row,
)
from analyzer_sim.dialects.rows.marker_rows import MarkerStyle, marker_of, marker_rows, put_state
from analyzer_sim.dialects.rows.settings_rows import inert
from analyzer_sim.instrument.functions.band_power import adjacent_powers_mw, band_power_mw, decibels
from analyzer_sim.instrument.functions.function_settings import OFF, SPECTRUM
from analyzer_sim.instrument.functions.occupied_bandwidth import Occupied, occupied_by_level, occupied_by_percent
from analyzer_sim.scpi.parameters import Choice

_SENSE = "[SENSe]"
_MARKER = "CALCulate:MARKer<4>"
_TOP_HZ = 3.2e9
CHANNEL = Figure("channel width", 100.0, _TOP_HZ, 2e6)
MAIN = Figure("main width", 100.0, _TOP_HZ, 1e6)
ADJACENT = Figure("adjacent width", 100.0, _TOP_HZ, 1e6)
SPACING = Figure("adjacent spacing", 100.0, 0.7e9, 2e6)
OCCUPIED_PERCENT = Figure("occupied percent", 10.0, 99.99, 99.0)
DECIBELS_DOWN = Figure("occupied decibels", 0.1, 100.0, 26.0)
_EXCURSION = Figure("peak excursion", 0.0, 200.0, 15.0)

STYLE = MarkerStyle(_MARKER, _EXCURSION, f"{_MARKER}:PEAK:EXCursion")


def _channel_power(call: Call) -> tuple[float, ...]:
    """Return the power in the channel and its density."""
    trace, width_hz = swept_trace(call), CHANNEL.load(call)
    power_dbm = decibels(band_power_mw(trace.level_dbm, trace.grid, middle_band(trace, width_hz)))
    return shown_level(call, power_dbm), shown_level(call, power_dbm - decibels(width_hz))


def _adjacent_powers(call: Call) -> tuple[float, ...]:
    """Return the main channel, the lower and the upper one, then both relative to the main one, dB."""
    trace = swept_trace(call)
    pairs = ((SPACING.load(call), ADJACENT.load(call)),)
    powers_mw = adjacent_powers_mw(trace.level_dbm, trace.grid, middle_band(trace, MAIN.load(call)), pairs)
    main, lower, upper = (decibels(power_mw) for power_mw in powers_mw)
    return (*(shown_level(call, level) for level in (main, lower, upper)), lower - main, upper - main)


def _occupied(call: Call) -> tuple[float, ...]:
    """Return the occupied bandwidth, its centre and how far that is from the centre of the span, Hz."""
    trace = swept_trace(call)
    found: Occupied
    if word(call, "occupied method", "PERC") == "PERC":
        found = occupied_by_percent(trace.level_dbm, trace.grid, OCCUPIED_PERCENT.load(call))
    else:
        found = occupied_by_level(trace.level_dbm, trace.grid, DECIBELS_DOWN.load(call))
    offset_hz = call.instrument.settings.offset_hz
    centre_hz = 0.5 * (trace.grid.start_hz + trace.grid.stop_hz)
    return found.bandwidth_hz, found.center_hz + offset_hz, found.center_hz - centre_hz


def _result(pattern: str, measure: Callable[[Call], tuple[float, ...]], *which: int) -> Command:
    """Return the row that answers some of the results of a measurement."""

    def query(call: Call) -> str:
        values = measure(call)
        return results(tuple(values[index] for index in which))

    return Command(f"MEASure:{pattern}", query=query, query_waits=True, query_starts=start_if_stale)


def _widen_to_span(call: Call) -> None:
    call.instrument.functions.figures[CHANNEL.name] = CHANNEL.limited(call.instrument.settings.span_hz)


def _put_mode(call: Call, mode: str) -> None:
    put_state(call, is_on=mode != OFF, style=STYLE)


def _put_function(call: Call, function: str) -> None:
    marker_of(call).function = function


def _put_measurement(call: Call, name: str) -> None:
    call.instrument.functions.select(SPECTRUM if name == OFF else name)


def _measurement(call: Call) -> str:
    name = call.instrument.functions.measurement
    return OFF if name == SPECTRUM else name


#: all rows of this file, for the dialect
FUNCTION_ROWS: tuple[Command, ...] = (
    *marker_rows(STYLE, "[:SET]:CENTer"),
    Command(
        f"{_MARKER}:MODE", _put_mode, lambda call: "POS" if marker_of(call).is_on else OFF, (Choice(("POSition", OFF)),)
    ),
    Command(
        f"{_MARKER}:FUNCtion",
        _put_function,
        lambda call: marker_of(call).function,
        (Choice(("NOISe", OFF)),),
    ),
    inert(f"{_MARKER}:X:READout", "FREQ", ("FREQuency",)),
    Command("INSTrument:MEASure", _put_measurement, _measurement, (Choice((OFF, "ACPR", "CHPower", "OBW")),)),
    hertz_row(f"{_SENSE}:CHPower:BWIDth|BANDwidth:INTegration", CHANNEL),
    Command(f"{_SENSE}:CHPower:FREQuency:SPAN:POWer", _widen_to_span),
    _result("CHPower", _channel_power, 0, 1),
    _result("CHPower:CHPower", _channel_power, 0),
    _result("CHPower:DENSity", _channel_power, 1),
    hertz_row(f"{_SENSE}:ACPRatio:BWIDth|BANDwidth:INTegration", MAIN),
    hertz_row(f"{_SENSE}:ACPRatio:OFFSet:BWIDth|BANDwidth[:INTegration]", ADJACENT),
    hertz_row(f"{_SENSE}:ACPRatio:OFFSet[:FREQuency]", SPACING),
    _result("ACPRatio:MAIN", _adjacent_powers, 0),
    _result("ACPRatio:LOWer:POWer", _adjacent_powers, 1),
    _result("ACPRatio:UPPer:POWer", _adjacent_powers, 2),
    _result("ACPRatio:LOWer", _adjacent_powers, 3),
    _result("ACPRatio:UPPer", _adjacent_powers, 4),
    word_row(f"{_SENSE}:OBWidth:METHod", "occupied method", ("PERCent", "DBC"), "PERC"),
    figure_row(f"{_SENSE}:OBWidth:PERCent", OCCUPIED_PERCENT, PERCENT),
    decibel_row(f"{_SENSE}:OBWidth:XDB", DECIBELS_DOWN),
    _result("OBWidth", _occupied, 0, 1),
    _result("OBWidth:OBWidth", _occupied, 0),
    _result("OBWidth:CENTroid", _occupied, 1),
    _result("OBWidth:OBWidth:FERRor", _occupied, 2),
)
