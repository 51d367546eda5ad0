"""Rohde & Schwarz: measurement functions. They read the trace shown; only the list sweeps on its own.

Deviations from the real instruments, on purpose: one transmission channel; the neighbours' distances and widths are
those that were set or, unset, those of the first pair times its number; sub-blocks and windows are one.
"""

from collections.abc import Callable
from dataclasses import replace

from analyzer_sim.dialects.rows.command_row import Call, Command
from analyzer_sim.dialects.rows.function_rows import (
    PERCENT,
    Figure,
    figure_row,
    hertz_row,
    middle_band,
    results,
    shown_level,
    swept_trace,
    switch_row,
    word,
    word_row,
)
from analyzer_sim.dialects.rows.marker_rows import (
    MarkerStyle,
    band_dbm,
    band_dbm_hz,
    marker_of,
    marker_rows,
    noise_dbm_hz,
    put_state,
    read_marker,
    span_row,
)
from analyzer_sim.dialects.rows.power_list_rows import POWER_LIST_ROWS
from analyzer_sim.dialects.rows.settings_rows import inert, number_text
from analyzer_sim.instrument.functions.band_power import (
    adjacent_powers_mw,
    band_power_mw,
    carrier_to_noise_db,
    decibels,
)
from analyzer_sim.instrument.functions.function_settings import OFF
from analyzer_sim.instrument.functions.occupied_bandwidth import occupied_by_percent
from analyzer_sim.instrument.settings.quantities import store
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import Boolean, Choice

_SENSE = "[SENSe<6>]"
_ACH = f"{_SENSE}:POWer:ACHannel"
_WIDTH = f"{_ACH}:BWIDth|BANDwidth"
_MARKER = "CALCulate<16>:MARKer<16>"
_POWER = f"{_MARKER}:FUNCtion:POWer<8>"
_BAND = f"{_MARKER}:FUNCtion:BPOWer"
_NOISE = f"{_MARKER}:FUNCtion:NOISe"
_MEASUREMENTS = ("CPOWer", "ACPower", "OBWidth", "OBANdwidth", "CN", "CN0")

_TOP_HZ = 26.5e9
CHANNEL = Figure("channel width", 100.0, 1e9, 14e3)
PAIRS = Figure("adjacent pairs", 0.0, 12.0, 1.0)
ADJACENT = Figure("adjacent width", 100.0, 1e9, 14e3)
ALTERNATE = Figure("alternate width", 100.0, 1e9, 14e3, "ALTernate")
SPACING = Figure("adjacent spacing", 100.0, _TOP_HZ, 14e3)
ALTERNATE_SPACING = Figure("alternate spacing", 100.0, _TOP_HZ, 14e3, "ALTernate")
OCCUPIED_PERCENT = Figure("occupied percent", 10.0, 99.9, 99.0)
TRANSMITTERS = Figure("channels", 1.0, 1.0, 1.0)
TRACE = Figure("marker trace", 1.0, 1.0, 1.0)
_EXCURSION = Figure("peak excursion", 0.0, 80.0, 6.0)

STYLE = MarkerStyle(_MARKER, _EXCURSION, f"{_MARKER}:PEXCursion", starts_at_peak=True, reads_function=False)


def _alternate_spacing_hz(call: Call, number: int) -> float:
    """Return the distance of an alternate pair: what was set, else the multiple of that of the adjacent pair."""
    figures = call.instrument.functions.figures
    return figures.get(f"{ALTERNATE_SPACING.name} {number}", (number + 1) * SPACING.load(call))


def _alternate_width_hz(call: Call, number: int) -> float:
    """Return the width of an alternate pair: what was set, else that of the adjacent pair."""
    return call.instrument.functions.figures.get(f"{ALTERNATE.name} {number}", ADJACENT.load(call))


def _alternate_row(pattern: str, figure: Figure, in_force: Callable[[Call, int], float]) -> Command:
    """Return the row of an alternate pair; its query tells what is in force."""
    row = hertz_row(pattern, figure)
    return replace(
        row, query=lambda call: number_text(in_force(call, call.suffix(figure.counted_by))), query_parameters=()
    )


def _neighbours(call: Call) -> tuple[tuple[float, float], ...]:
    """Return distance and width of each pair of neighbours, Hz."""
    pairs = [(SPACING.load(call), ADJACENT.load(call))]
    alternates = range(1, round(PAIRS.load(call)))
    pairs += [(_alternate_spacing_hz(call, number), _alternate_width_hz(call, number)) for number in alternates]
    return tuple(pairs[: round(PAIRS.load(call))])


def _per_hertz_db(call: Call, width_hz: float) -> float:
    return decibels(width_hz) if word(call, "per hertz", "0") == "1" else 0.0


def channel_power(call: Call) -> tuple[float, ...]:
    """Return the power in the channel about the centre, or its density."""
    trace, width_hz = swept_trace(call), CHANNEL.load(call)
    power_dbm = decibels(band_power_mw(trace.level_dbm, trace.grid, middle_band(trace, width_hz)))
    return (shown_level(call, power_dbm - _per_hertz_db(call, width_hz)),)


def adjacent_powers(call: Call) -> tuple[float, ...]:
    """Return the power of the channel, then of the neighbours, pair by pair, lower first; relative ones in dB."""
    trace = swept_trace(call)
    band = middle_band(trace, CHANNEL.load(call))
    powers_mw = adjacent_powers_mw(trace.level_dbm, trace.grid, band, _neighbours(call))
    levels_dbm = [decibels(power_mw) for power_mw in powers_mw]
    main = shown_level(call, levels_dbm[0] - _per_hertz_db(call, band.width_hz))
    if word(call, "adjacent mode", "REL") == "REL":
        return (main, *(level_dbm - levels_dbm[0] for level_dbm in levels_dbm[1:]))
    widths_hz = [width_hz for _, width_hz in _neighbours(call) for _ in range(2)]
    shown = zip(levels_dbm[1:], widths_hz, strict=True)
    return (main, *(shown_level(call, level - _per_hertz_db(call, width)) for level, width in shown))


def occupied_bandwidth(call: Call) -> tuple[float, ...]:
    """Return the occupied bandwidth of the trace, Hz."""
    trace = swept_trace(call)
    return (occupied_by_percent(trace.level_dbm, trace.grid, OCCUPIED_PERCENT.load(call)).bandwidth_hz,)


def carrier_to_noise(call: Call) -> tuple[float, ...]:
    """Return the highest point over the noise in the channel, dB."""
    trace = swept_trace(call)
    return (carrier_to_noise_db(trace.level_dbm, trace.grid, middle_band(trace, CHANNEL.load(call))),)


def carrier_to_density(call: Call) -> tuple[float, ...]:
    """Return the highest point over the density of the noise in the channel, dB Hz."""
    return (carrier_to_noise(call)[0] + decibels(CHANNEL.load(call)),)


#: word of ``SELect`` and ``RESult?`` -> what is measured
MEASURES: dict[str, Callable[[Call], tuple[float, ...]]] = {
    "CPOW": channel_power,
    "ACP": adjacent_powers,
    "OBW": occupied_bandwidth,
    "OBAN": occupied_bandwidth,
    "CN": carrier_to_noise,
    "CN0": carrier_to_density,
}


def _select(call: Call, measurement: str) -> None:
    """Select a power measurement; a detector that follows the measurement becomes RMS."""
    functions, settings = call.instrument.functions, call.instrument.settings
    functions.words["power"] = measurement
    if settings.is_detector_auto and settings.detector != "RMS":
        settings.detector = "RMS"
        call.instrument.invalidate()


def _switch_off(call: Call, is_on: bool) -> None:  # noqa: FBT001 - the one value of the command
    if is_on:
        raise ScpiError(-224, "a measurement is switched on by SELect")
    call.instrument.functions.words["power"] = OFF


def _keep_standard(_call: Call, _standard: str) -> None:
    """Take the settings of a radio standard: there is none but one's own."""


def _adjust(call: Call, _measurement: str) -> None:
    """Choose span, filter and detector for the channels set."""
    settings = call.instrument.settings
    neighbours = _neighbours(call)
    reach_hz = max([0.5 * CHANNEL.load(call), *(offset + 0.5 * width for offset, width in neighbours)])
    store(settings, "span_hz", 2.4 * reach_hz)
    store(settings, "rbw_hz", CHANNEL.load(call) / 50.0)
    settings.is_vbw_auto = settings.is_time_auto = True
    settings.detector = "RMS"
    call.instrument.invalidate()


def _read(measure: Callable[[Call], tuple[float, ...]], pattern: str) -> Command:
    return Command(pattern, query=lambda call: results(measure(call)), query_waits=True)


def _put_function(function: str) -> Callable[..., None]:
    def write(call: Call, is_on: bool) -> None:  # noqa: FBT001 - the one value of the command
        if is_on and not marker_of(call).is_on:
            put_state(call, is_on=True, style=STYLE)
        marker_of(call).function = function if is_on else OFF

    return write


def _has_function(function: str) -> Callable[[Call], str]:
    return lambda call: str(int(marker_of(call).function == function))


def _functions_off(function: str) -> Callable[[Call], None]:
    def write(call: Call) -> None:
        for marker in call.instrument.functions.markers.values():
            marker.function = OFF if marker.function == function else marker.function

    return write


def _put_band_mode(call: Call, mode: str) -> None:
    marker_of(call).is_density = mode == "DENS"


def _band_result(call: Call) -> str:
    return read_marker(call, STYLE, band_dbm_hz if marker_of(call).is_density else band_dbm)


_POWER_ROWS = (
    Command(f"{_POWER}:SELect", _select, lambda call: word(call, "power", OFF), (Choice(_MEASUREMENTS),)),
    Command(
        f"{_POWER}:RESult",
        query=lambda call, measurement: results(MEASURES[measurement](call)),
        query_parameters=(Choice(_MEASUREMENTS),),
        query_required=1,
        query_waits=True,
    ),
    switch_row(f"{_POWER}:RESult:PHZ", "per hertz"),
    Command(f"{_POWER}[:STATe]", _switch_off, lambda call: str(int(word(call, "power", OFF) != OFF)), (Boolean(),)),
    inert(f"{_POWER}:MODE", "WRIT", ("WRITe",)),
    Command(f"{_POWER}:PRESet", _keep_standard, parameters=(Choice(("NONE",)),)),
    hertz_row(f"{_WIDTH}[:CHANnel<18>]", CHANNEL),
    hertz_row(f"{_WIDTH}:ACHannel", ADJACENT),
    _alternate_row(f"{_WIDTH}:ALTernate<11>", ALTERNATE, _alternate_width_hz),
    hertz_row(f"{_ACH}:SPACing[:ACHannel]", SPACING),
    _alternate_row(f"{_ACH}:SPACing:ALTernate<11>", ALTERNATE_SPACING, _alternate_spacing_hz),
    figure_row(f"{_ACH}:ACPairs", PAIRS, is_whole=True),
    figure_row(f"{_ACH}:TXCHannel:COUNt", TRANSMITTERS, is_whole=True),
    word_row(f"{_ACH}:MODE", "adjacent mode", ("ABSolute", "RELative"), "REL"),
    Command(f"{_ACH}:PRESet", _adjust, parameters=(Choice(_MEASUREMENTS),)),
    figure_row(f"{_SENSE}:POWer:BWIDth|BANDwidth", OCCUPIED_PERCENT, PERCENT),
    _read(adjacent_powers, "FETCh<16>:POWer:ACPower"),
    _read(channel_power, "FETCh<16>:CPOWer:RESult"),
    _read(adjacent_powers, "FETCh<16>:ACPower:RESult"),
    _read(occupied_bandwidth, "FETCh<16>:OBW:RESult"),
)

_MARKER_FUNCTION_ROWS = (
    Command(f"{_BAND}[:STATe]", _put_function("BPOW"), _has_function("BPOW"), (Boolean(),)),
    span_row(f"{_BAND}:SPAN"),
    Command(
        f"{_BAND}:MODE",
        _put_band_mode,
        lambda call: "DENS" if marker_of(call).is_density else "POW",
        (Choice(("POWer", "DENSity")),),
    ),
    Command(f"{_BAND}:RESult", query=_band_result, query_waits=True),
    Command(f"{_BAND}:AOFF", _functions_off("BPOW")),
    Command(f"{_NOISE}[:STATe]", _put_function("NOIS"), _has_function("NOIS"), (Boolean(),)),
    Command(f"{_NOISE}:RESult", query=lambda call: read_marker(call, STYLE, noise_dbm_hz), query_waits=True),
    Command(f"{_NOISE}:AOFF", _functions_off("NOIS")),
    figure_row(f"{_MARKER}:TRACe", TRACE, is_whole=True),
)

#: all rows of this file, for the dialect
FUNCTION_ROWS: tuple[Command, ...] = (
    *marker_rows(STYLE, ":FUNCtion:CENTer"),
    *_MARKER_FUNCTION_ROWS,
    *_POWER_ROWS,
    *POWER_LIST_ROWS,
)
