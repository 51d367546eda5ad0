"""Rows that move the span or the reference level by themselves: full, zero, previous, halved; fitted to the signals."""

import math

import numpy as np

from analyzer_sim.dialects.rows.command_row import Call, Command
from analyzer_sim.instrument.painter import Trace
from analyzer_sim.instrument.settings.instrument_settings import reset_state
from analyzer_sim.instrument.settings.quantities import store
from analyzer_sim.scpi.parameters import Boolean

#: span left by the search for the strongest signal, Hz
_TUNED_SPAN_HZ = 10e6
_TUNING_POINTS = 50001
_TUNING_RBW_HZ = 1e6


def step_auto_row(pattern: str) -> Command:
    """Return the row that couples the step of the centre to the span."""

    def write(call: Call, is_auto: bool) -> None:  # noqa: FBT001 - the one value of the command
        settings = call.instrument.settings
        settings.step_chosen_hz = None if is_auto else settings.step_hz

    return Command(pattern, write, lambda call: str(int(call.instrument.settings.step_chosen_hz is None)), (Boolean(),))


def full_span_row(pattern: str) -> Command:
    """Return the row that sweeps the whole range."""

    def write(call: Call) -> None:
        store(call.instrument.settings, "span_hz", call.instrument.model.max_frequency_hz)
        call.instrument.invalidate()

    return Command(pattern, write)


def zero_span_row(pattern: str) -> Command:
    """Return the row that stands at the centre."""

    def write(call: Call) -> None:
        store(call.instrument.settings, "span_hz", 0.0)
        call.instrument.invalidate()

    return Command(pattern, write)


def previous_span_row(pattern: str) -> Command:
    """Return the row that goes back to the span before the last change of it."""

    def write(call: Call) -> None:
        settings = call.instrument.settings
        if settings.previous_span_hz is not None:
            store(settings, "span_hz", settings.previous_span_hz)
            call.instrument.invalidate()

    return Command(pattern, write)


def scaled_span_row(pattern: str, factor: float) -> Command:
    """Return the row that makes the span ``factor`` times as wide, within its limits."""

    def write(call: Call) -> None:
        store(call.instrument.settings, "span_hz", factor * call.instrument.settings.span_hz)
        call.instrument.invalidate()

    return Command(pattern, write)


def _whole_range(call: Call) -> Trace:
    """Look at all that the instrument can receive, with the mean of power."""
    wide = reset_state(call.instrument.model)
    wide.points, wide.detector = _TUNING_POINTS, "RMS"
    store(wide, "rbw_hz", _TUNING_RBW_HZ)
    return call.instrument.glimpse(wide)


def _tune(call: Call) -> None:
    """Centre the strongest signal of the whole range."""
    settings, trace = call.instrument.settings, _whole_range(call)
    call.instrument.invalidate()
    store(settings, "span_hz", _TUNED_SPAN_HZ)
    store(settings, "center_hz", trace.grid.frequency_hz[int(np.argmax(trace.level_dbm))] + settings.offset_hz)


def _adjust_level(call: Call) -> None:
    """Put the reference level at the sum of all signals, rounded up."""
    settings, trace = call.instrument.settings, _whole_range(call)
    total_mw = float(np.sum(10.0 ** (0.1 * trace.level_dbm))) * trace.grid.spacing_hz / trace.grid.enbw_hz
    call.instrument.invalidate()
    store(settings, "reference_dbm", math.ceil(10.0 * math.log10(total_mw)) + settings.level_offset_db)


def tune_row(pattern: str) -> Command:
    """Return the row that searches the strongest signal and centres it in a span of 10 MHz."""
    return Command(pattern, _tune)


def adjust_level_row(pattern: str) -> Command:
    """Return the row that fits the reference level to what comes in."""
    return Command(pattern, _adjust_level)


def adjust_all_row(pattern: str) -> Command:
    """Return the row that fits frequency and reference level."""

    def write(call: Call) -> None:
        _tune(call)
        _adjust_level(call)

    return Command(pattern, write)
