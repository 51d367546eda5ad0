"""Keysight X series: measurements that sweep on their own (CHPower, OBWidth, ACPower) and marker functions.

The verbs, for each measurement (SCPI-99, volume 2, chapter 3)::

    CONFigure   select it and return its settings to their defaults; CONFigure:..:NDEFault keeps them
    INITiate    select it as it is set and start a sweep
    FETCh?      answer from the sweep there is; -230 when there is none, -221 when another measurement is selected
    READ?       INITiate and FETCh?          MEASure?    CONFigure, INITiate and FETCh?

A result that does not exist is 9.91E37. Deviations from the real instruments, on purpose: of the ten results numbered
behind a measurement the first and, for the trace, the second are there; the list of offsets holds six.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from analyzer_sim.dialects.rows.command_row import Call, Command
from analyzer_sim.dialects.rows.function_rows import (
    NOT_A_NUMBER,
    PERCENT,
    Figure,
    decibel_row,
    figure_row,
    hertz_row,
    middle_band,
    results,
    shown_level,
    start_sweep,
    swept_trace,
    switch_row,
)
from analyzer_sim.dialects.rows.marker_rows import MarkerStyle, marker_of, marker_rows, put_state, span_row
from analyzer_sim.dialects.rows.settings_rows import number_text
from analyzer_sim.instrument.functions.band_power import Band, adjacent_powers_mw, band_power_mw, decibels
from analyzer_sim.instrument.functions.function_settings import OFF, swept_settings
from analyzer_sim.instrument.functions.occupied_bandwidth import occupied_by_level, occupied_by_percent, trace_power_dbm
from analyzer_sim.instrument.levels import UNITS, ascii_list
from analyzer_sim.instrument.settings.instrument_settings import Settings
from analyzer_sim.instrument.settings.quantities import load, shown_limits, store
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import HERTZ, SECONDS, Boolean, Choice, Numeric

_SENSE = "[SENSe<1>]"
_MARKER = "CALCulate:MARKer<12>"
_OFFSETS = 6
_TOP_HZ = 26.5e9

CHANNEL = Figure("CHP.channel", 1e3, 1e9, 2e6)
OCCUPIED_PERCENT = Figure("OBW.percent", 10.0, 99.99, 99.0)
DECIBELS_DOWN = Figure("OBW.down", -100.0, -0.1, -26.0)
CARRIER = Figure("ACP.carrier", 1e3, 1e9, 2e6)
#: distance and width of the pairs of neighbours, Hz; zero distance = not measured
OFFSET = Figure("ACP.offset", 0.0, _TOP_HZ, 0.0)
OFFSET_WIDTH = Figure("ACP.width", 1e3, 1e9, 2e6)
_FIRST_OFFSET_HZ = 3e6
_EXCURSION = Figure("peak excursion", 0.0, 100.0, 6.0)

STYLE = MarkerStyle(_MARKER, _EXCURSION, f"{_MARKER}:PEAK:EXCursion", is_nearest=True, off_answer=NOT_A_NUMBER)


@dataclass(frozen=True, slots=True)
class Measurement:
    """One measurement with settings of its own."""

    #: name of its settings and answer of ``CONFigure?``
    name: str
    #: header: ``CHPower``
    pattern: str
    #: settings of its sweep after CONFigure
    span_hz: float
    averages: float
    measure: Callable[[Call], tuple[float, ...]]
    #: sub-header -> which of the results it answers
    parts: tuple[tuple[str, int], ...]


def _channel_power(call: Call) -> tuple[float, ...]:
    """Return the power in the channel and its density."""
    trace, width_hz = swept_trace(call), CHANNEL.load(call)
    power_dbm = decibels(band_power_mw(trace.level_dbm, trace.grid, middle_band(trace, width_hz)))
    return shown_level(call, power_dbm), shown_level(call, power_dbm - decibels(width_hz))


def _occupied_bandwidth(call: Call) -> tuple[float, ...]:
    """Return bandwidth, power, span, points, filter, frequency error and the bandwidth x dB down."""
    trace = swept_trace(call)
    grid = trace.grid
    occupied = occupied_by_percent(trace.level_dbm, grid, OCCUPIED_PERCENT.load(call))
    down = occupied_by_level(trace.level_dbm, grid, DECIBELS_DOWN.load(call))
    return (
        occupied.bandwidth_hz,
        shown_level(call, trace_power_dbm(trace.level_dbm, grid)),
        grid.stop_hz - grid.start_hz,
        float(grid.points),
        grid.rbw_hz,
        occupied.center_hz - 0.5 * (grid.start_hz + grid.stop_hz),
        down.bandwidth_hz,
    )


def _listed(call: Call, figure: Figure, first: float | None = None) -> list[float]:
    """Return the values of a list, one an offset."""
    figures = call.instrument.functions.figures
    defaults = [figure.default if first is None or number else first for number in range(_OFFSETS)]
    return [figures.get(f"{figure.name} {number}", default) for number, default in enumerate(defaults)]


def _adjacent_powers(call: Call) -> tuple[float, ...]:
    """Return the carrier, relative and absolute, then of each offset the lower and the upper one, the same way."""
    trace = swept_trace(call)
    carrier: Band = middle_band(trace, CARRIER.load(call))
    pairs = tuple(zip(_listed(call, OFFSET, _FIRST_OFFSET_HZ), _listed(call, OFFSET_WIDTH), strict=True))
    powers_mw = adjacent_powers_mw(trace.level_dbm, trace.grid, carrier, pairs)
    is_on = [True, *(offset_hz > 0.0 for offset_hz, _ in pairs for _ in range(2))]
    levels_dbm = [decibels(power if on else 0.0) for power, on in zip(powers_mw, is_on, strict=True)]
    return tuple(
        value for level_dbm in levels_dbm for value in (level_dbm - levels_dbm[0], shown_level(call, level_dbm))
    )


MEASUREMENTS = (
    Measurement("CHP", "CHPower", 3e6, 10.0, _channel_power, (("CHPower", 0), ("DENSity", 1))),
    Measurement("OBW", "OBWidth", 3e6, 10.0, _occupied_bandwidth, (("OBWidth", 0), ("FERRor", 5), ("XDB", 6))),
    Measurement("ACP", "ACPower", 10e6, 10.0, _adjacent_powers, ()),
)


def select(call: Call, measurement: Measurement, *, is_reset: bool) -> None:
    """Select a measurement; the first time, and when wanted, with its default settings."""
    functions, name = call.instrument.functions, measurement.name
    if is_reset:
        functions.forget(f"{name}.")
    functions.figures.setdefault(f"{name}.span_hz", measurement.span_hz)
    functions.figures.setdefault(f"{name}.averages", measurement.averages)
    if functions.measurement != name or is_reset:
        functions.select(name, is_own_sweep=True)
        call.instrument.abort()
        call.instrument.invalidate()


def _verb_rows(measurement: Measurement) -> tuple[Command, ...]:
    """Return the rows of the five verbs of one measurement."""

    def configure(call: Call) -> None:
        select(call, measurement, is_reset=True)

    def keep(call: Call) -> None:
        select(call, measurement, is_reset=False)

    def initiate(call: Call) -> None:
        keep(call)
        call.instrument.initiate()

    def read(call: Call) -> None:
        keep(call)
        start_sweep(call)

    def measure(call: Call) -> None:
        configure(call)
        start_sweep(call)

    pattern = measurement.pattern
    return (
        Command(f"CONFigure:{pattern}", configure),
        Command(f"CONFigure:{pattern}:NDEFault", keep),
        Command(f"INITiate:{pattern}", initiate),
        *_answer_rows("FETCh", measurement, None),
        *_answer_rows("READ", measurement, read),
        *_answer_rows("MEASure", measurement, measure),
    )


def _answer_rows(verb: str, measurement: Measurement, starts: Callable[[Call], None] | None) -> tuple[Command, ...]:
    """Return the rows that answer: all results, the trace, and single results."""

    def checked(call: Call) -> tuple[float, ...]:
        if call.instrument.functions.measurement != measurement.name:
            raise ScpiError(-221, f"{measurement.name} is not selected")
        return measurement.measure(call)

    def everything(call: Call) -> str:
        values = checked(call)
        if call.suffix(measurement.pattern) == 1:
            return results(values)
        return ascii_list(UNITS[call.instrument.settings.unit](call.instrument.trace().level_dbm))

    def part(index: int) -> Callable[[Call], str]:
        return lambda call: results((checked(call)[index],))

    head = f"{verb}:{measurement.pattern}"
    return (
        Command(f"{head}<2>", query=everything, query_waits=True, query_starts=starts),
        *(
            Command(f"{head}<2>:{name}", query=part(index), query_waits=True, query_starts=starts)
            for name, index in measurement.parts
        ),
    )


def _in_force(call: Call, name: str) -> Settings:
    """Return the settings the sweeps of a measurement are taken with, selected or not."""
    functions = replace(call.instrument.functions, measurement=name, is_own_sweep=True)
    return swept_settings(call.instrument.settings, functions)


def _coupled_rows(pattern: str, name: str, quantity: str, units: Mapping[str, float]) -> tuple[Command, Command]:
    """Return the rows of a filter or a time of one measurement and of its coupling."""
    key = f"{name}.{quantity}"

    def write(call: Call, value: float | str) -> None:
        settings = _in_force(call, name)
        limits = shown_limits(settings, quantity)
        words = {"MIN": limits.low, "MAX": limits.high, "DEF": limits.default}
        if isinstance(value, str) and value not in words:
            raise ScpiError(-141, value)
        wanted = words[value] if isinstance(value, str) else value
        is_clamped = store(settings, quantity, wanted)
        call.instrument.functions.figures[key] = load(settings, quantity)
        call.instrument.invalidate()
        if is_clamped:
            raise ScpiError(-222, f"{wanted:g}")

    def write_auto(call: Call, is_auto: bool) -> None:  # noqa: FBT001 - the one value of the command
        figures = call.instrument.functions.figures
        if is_auto:
            figures.pop(key, None)
        else:
            figures[key] = load(_in_force(call, name), quantity)
        call.instrument.invalidate()

    return (
        Command(pattern, write, lambda call: number_text(load(_in_force(call, name), quantity)), (Numeric(units),)),
        Command(
            f"{pattern}:AUTO",
            write_auto,
            lambda call: str(int(key not in call.instrument.functions.figures)),
            (Boolean(),),
        ),
    )


def _sweep_rows(measurement: Measurement) -> tuple[Command, ...]:
    """Return the rows of the sweep of one measurement: span, filter, time, averages."""
    head, name = f"{_SENSE}:{measurement.pattern}", measurement.name
    span = Figure(f"{name}.span_hz", 100.0, _TOP_HZ, measurement.span_hz)
    averages = Figure(f"{name}.averages", 1.0, 1000.0, measurement.averages)
    return (
        hertz_row(f"{head}:FREQuency:SPAN", span, reshapes=True),
        figure_row(f"{head}:AVERage:COUNt", averages, reshapes=True, is_whole=True),
        switch_row(f"{head}:AVERage[:STATe]", f"{name}.averaging", "1", reshapes=True),
        *_coupled_rows(f"{head}:BANDwidth|BWIDth[:RESolution]", name, "rbw_hz", HERTZ),
        *_coupled_rows(f"{head}:SWEep:TIME", name, "time_s", SECONDS),
    )


def _list_row(pattern: str, figure: Figure, first: float | None = None) -> Command:
    """Return the row of a list of up to six numbers; those that are left out are not changed."""

    def write(call: Call, *values: float | str) -> None:
        for number, value in enumerate(values):
            if isinstance(value, str):
                raise ScpiError(-141, value)
            call.instrument.functions.figures[f"{figure.name} {number}"] = figure.limited(value)
        if any(figure.limited(float(value)) != value for value in values):
            raise ScpiError(-222)

    return Command(
        pattern,
        write,
        lambda call: results(tuple(_listed(call, figure, first))),
        (Numeric(HERTZ),) * _OFFSETS,
        optional=_OFFSETS - 1,
    )


def _put_mode(call: Call, mode: str) -> None:
    """Switch a marker by its mode; a marker relative to another one is not among them."""
    put_state(call, is_on=mode != OFF, style=STYLE)


def _put_function(call: Call, function: str) -> None:
    """Choose what a marker reads; one that is off comes on."""
    marker_of(call).function = function
    if function != OFF:
        marker_of(call).is_on = True


_MARKER_FUNCTION_ROWS = (
    Command(
        f"{_MARKER}:MODE",
        _put_mode,
        lambda call: "POS" if marker_of(call).is_on else OFF,
        (Choice(("POSition", OFF)),),
    ),
    Command(
        f"{_MARKER}:FUNCtion",
        _put_function,
        lambda call: marker_of(call).function,
        (Choice(("NOISe", "BPOWer", "BDENsity", OFF)),),
    ),
    span_row(f"{_MARKER}:FUNCtion:BAND:SPAN"),
)

_FIGURE_ROWS = (
    hertz_row(f"{_SENSE}:CHPower:BANDwidth|BWIDth:INTegration", CHANNEL),
    figure_row(f"{_SENSE}:OBWidth:PERCent", OCCUPIED_PERCENT, PERCENT),
    decibel_row(f"{_SENSE}:OBWidth:XDB", DECIBELS_DOWN),
    hertz_row(f"{_SENSE}:ACPower:CARRier:LIST:BANDwidth|BWIDth[:INTegration]", CARRIER),
    _list_row(f"{_SENSE}:ACPower:OFFSet:LIST[:FREQuency]", OFFSET, _FIRST_OFFSET_HZ),
    _list_row(f"{_SENSE}:ACPower:OFFSet:LIST:BANDwidth|BWIDth[:INTegration]", OFFSET_WIDTH),
)

#: all rows of this file, for the dialect
FUNCTION_ROWS: tuple[Command, ...] = (
    *marker_rows(STYLE, "[:SET]:CENTer"),
    *_MARKER_FUNCTION_ROWS,
    *(row for measurement in MEASUREMENTS for row in (*_verb_rows(measurement), *_sweep_rows(measurement))),
    *_FIGURE_ROWS,
)
