"""Rows of markers: on and off, position, level, searches, excursion. What makes differ in is a :class:`MarkerStyle`.

A marker stands at a frequency and reads the nearest point of the trace; in continuous sweep every reading is of a fresh
trace. Frequencies are shown with the frequency offset.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from analyzer_sim.dialects.rows.command_row import Call, Command
from analyzer_sim.dialects.rows.function_rows import Figure, decibel_row, result_text, shown_level, swept_trace
from analyzer_sim.dialects.rows.settings_rows import number_text
from analyzer_sim.instrument.functions.band_power import Band, band_power_mw, decibels, noise_density_dbm_hz
from analyzer_sim.instrument.functions.function_settings import OFF, Marker
from analyzer_sim.instrument.functions.markers import Search, next_peak
from analyzer_sim.instrument.painter import Trace
from analyzer_sim.instrument.settings.quantities import store
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import HERTZ, Boolean, Numeric

#: a band marker spans this part of the trace until its width is set
_BAND_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class MarkerStyle:
    """Markers of one make: headers and behaviour."""

    #: header of one marker: ``CALCulate<16>:MARKer<16>``
    pattern: str
    excursion: Figure
    excursion_pattern: str
    #: a search to a side finds the nearest peak, not the highest of the lower ones
    is_nearest: bool = False
    #: a search that finds nothing puts the marker on the end of the trace
    ends_at_edge: bool = False
    #: what a marker that is off answers; empty = -221
    off_answer: str = ""
    #: a marker that is switched on goes to the highest point, not to the centre
    starts_at_peak: bool = False
    #: the level of a marker is the result of its function, not the point of the trace
    reads_function: bool = True


def marker_of(call: Call) -> Marker:
    """Return the marker a header names."""
    return call.instrument.functions.marker(call.suffix("MARKer"))


def position(call: Call, trace: Trace, point: int) -> None:
    """Put the marker on a point of the trace and switch it on."""
    marker = marker_of(call)
    marker.is_on, marker.frequency_hz = True, float(trace.grid.frequency_hz[point])


def marker_band(marker: Marker, trace: Trace) -> Band:
    """Return the band of a band marker."""
    share_hz = _BAND_SHARE * (trace.grid.stop_hz - trace.grid.start_hz)
    return Band(_position_hz(marker, trace), share_hz if marker.span_hz is None else marker.span_hz)


def _position_hz(marker: Marker, trace: Trace) -> float:
    centre_hz = 0.5 * (trace.grid.start_hz + trace.grid.stop_hz)
    return centre_hz if marker.frequency_hz is None else marker.frequency_hz


def _point(marker: Marker, trace: Trace) -> int:
    return trace.grid.nearest(_position_hz(marker, trace))


def _level_dbm(marker: Marker, trace: Trace) -> float:
    return float(trace.level_dbm[_point(marker, trace)])


def noise_dbm_hz(marker: Marker, trace: Trace) -> float:
    """Return the density around a marker, dBm/Hz."""
    return noise_density_dbm_hz(trace.level_dbm, trace.grid, _position_hz(marker, trace), trace.detector)


def band_dbm(marker: Marker, trace: Trace) -> float:
    """Return the power in the band of a marker, dBm; NaN when the band is not wholly inside the trace."""
    return decibels(band_power_mw(trace.level_dbm, trace.grid, marker_band(marker, trace)))


def band_dbm_hz(marker: Marker, trace: Trace) -> float:
    """Return the density in the band of a marker, dBm/Hz."""
    return band_dbm(marker, trace) - decibels(marker_band(marker, trace).width_hz)


#: function of a marker -> what it reads from a trace, dBm or dBm/Hz
READINGS: dict[str, Callable[[Marker, Trace], float]] = {
    OFF: _level_dbm,
    "NOIS": noise_dbm_hz,
    "BPOW": band_dbm,
    "BDEN": band_dbm_hz,
}


def put_state(call: Call, *, is_on: bool, style: MarkerStyle) -> None:
    """Switch a marker; one that comes on for the first time is placed as the make does."""
    marker = marker_of(call)
    if not is_on:
        call.instrument.functions.markers[call.suffix("MARKer")] = Marker()
        return
    marker.is_on = True
    if style.starts_at_peak and marker.frequency_hz is None:
        with suppress(ScpiError):  # without a trace it stands at the centre
            _to_extreme(call, 1.0)


def read_marker(call: Call, style: MarkerStyle, reading: Callable[[Marker, Trace], float] | None = None) -> str:
    """Return what the marker reads, in the unit of the display."""
    marker = marker_of(call)
    if not marker.is_on:
        return _off(style)
    chosen = reading or READINGS[marker.function if style.reads_function else OFF]
    return result_text(shown_level(call, chosen(marker, swept_trace(call))))


def _off(style: MarkerStyle) -> str:
    if not style.off_answer:
        raise ScpiError(-221, "marker off")
    return style.off_answer


def _put_frequency(call: Call, value: float | str) -> None:
    settings = call.instrument.swept
    words = {"MIN": settings.start_hz, "MAX": settings.stop_hz, "DEF": settings.center_hz}
    if isinstance(value, str) and value not in words:
        raise ScpiError(-141, value)
    if not settings.span_hz:
        raise ScpiError(-221, "zero span")
    wanted_hz = words[value] if isinstance(value, str) else value - settings.offset_hz
    inside_hz = min(max(wanted_hz, settings.start_hz), settings.stop_hz)
    step_hz = settings.span_hz / max(settings.points - 1, 1)
    marker = marker_of(call)
    marker.is_on = True
    marker.frequency_hz = settings.start_hz + round((inside_hz - settings.start_hz) / step_hz) * step_hz
    if inside_hz != wanted_hz:
        raise ScpiError(-222, f"{value:g}" if not isinstance(value, str) else value)


def _frequency(call: Call, style: MarkerStyle) -> str:
    marker, settings = marker_of(call), call.instrument.swept
    if not marker.is_on:
        return _off(style)
    frequency_hz = settings.center_hz if marker.frequency_hz is None else marker.frequency_hz
    return number_text(frequency_hz + settings.offset_hz)


def _to_extreme(call: Call, sign: float) -> None:
    trace = swept_trace(call)
    position(call, trace, int((sign * trace.level_dbm).argmax()))


def _to_next(call: Call, search: Search, style: MarkerStyle) -> None:
    trace = swept_trace(call)
    marker = marker_of(call)
    point = _point(marker, trace) if marker.is_on else int(trace.level_dbm.argmax())
    excursion_db = style.excursion.load(call)
    found = next_peak(trace.level_dbm, excursion_db, point, search, is_nearest=style.is_nearest)
    if found is None and style.ends_at_edge and search is not Search.NEXT:
        found = 0 if search is Search.LEFT else trace.grid.points - 1
    position(call, trace, point if found is None else found)


def _all_off(call: Call) -> None:
    call.instrument.functions.markers.clear()


def _to_center(call: Call) -> None:
    marker = marker_of(call)
    if not marker.is_on:
        raise ScpiError(-221, "marker off")
    if marker.frequency_hz is not None:
        settings = call.instrument.settings
        store(settings, "center_hz", marker.frequency_hz + settings.offset_hz)
        call.instrument.invalidate()


def marker_rows(style: MarkerStyle, center_pattern: str) -> tuple[Command, ...]:
    """Return the rows every make has."""
    head = style.pattern

    def put(call: Call, is_on: bool) -> None:  # noqa: FBT001 - the one value of the command
        put_state(call, is_on=is_on, style=style)

    def search(kind: Search) -> Callable[[Call], None]:
        return lambda call: _to_next(call, kind, style)

    return (
        Command(f"{head}[:STATe]", put, lambda call: str(int(marker_of(call).is_on)), (Boolean(),)),
        Command(f"{head}:AOFF", _all_off),
        Command(f"{head}:X", _put_frequency, lambda call: _frequency(call, style), (Numeric(HERTZ),)),
        Command(f"{head}:Y", query=lambda call: read_marker(call, style), query_waits=True),
        Command(f"{head}:MAXimum[:PEAK]", lambda call: _to_extreme(call, 1.0), write_waits=True),
        Command(f"{head}:MAXimum:NEXT", search(Search.NEXT), write_waits=True),
        Command(f"{head}:MAXimum:LEFT", search(Search.LEFT), write_waits=True),
        Command(f"{head}:MAXimum:RIGHt", search(Search.RIGHT), write_waits=True),
        Command(f"{head}:MINimum[:PEAK]", lambda call: _to_extreme(call, -1.0), write_waits=True),
        Command(f"{head}{center_pattern}", _to_center),
        decibel_row(style.excursion_pattern, style.excursion),
    )


def span_row(pattern: str) -> Command:
    """Return the row of the width of a band marker."""

    def write(call: Call, value: float | str) -> None:
        if isinstance(value, str):
            raise ScpiError(-141, value)
        if not 0.0 < value < math.inf:
            raise ScpiError(-222, f"{value:g}")
        marker_of(call).span_hz = value

    def query(call: Call) -> str:
        span_hz = marker_of(call).span_hz
        return number_text(_BAND_SHARE * call.instrument.swept.span_hz if span_hz is None else span_hz)

    return Command(pattern, write, query, (Numeric(HERTZ),))
