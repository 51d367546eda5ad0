"""Rows of the measurement functions, made from a header and a figure; and the texts of their answers.

Law of this file: a figure knows its limits and what it is after ``*RST``; what was never set is not stored. A value out
of range is stored at its limit and then reported as -222.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from analyzer_sim.dialects.rows.command_row import Call, Command
from analyzer_sim.dialects.rows.settings_rows import number_text
from analyzer_sim.instrument.functions.band_power import Band
from analyzer_sim.instrument.levels import UNITS
from analyzer_sim.instrument.painter import Trace
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import DECIBELS, HERTZ, PURE, Boolean, Choice, Numeric

#: not a number, as SCPI-99 writes it (7.2.1.5)
NOT_A_NUMBER = "9.91E37"
PERCENT: Mapping[str, float] = {"PCT": 1.0}


class Figure(NamedTuple):
    """One numeric setting of a measurement function."""

    name: str
    low: float
    high: float
    #: after ``*RST``
    default: float
    #: mnemonic whose number tells which of several is meant; empty = there is one
    counted_by: str = ""

    def key(self, call: Call) -> str:
        """Return the name under which the figure of this header is stored."""
        return f"{self.name} {call.suffix(self.counted_by)}" if self.counted_by else self.name

    def load(self, call: Call) -> float:
        """Return the value in force."""
        return call.instrument.functions.figures.get(self.key(call), self.default)

    def limited(self, value: float) -> float:
        """Return the value within the limits."""
        return min(max(value, self.low), self.high)


def figure_row(
    pattern: str, figure: Figure, units: Mapping[str, float] = PURE, *, reshapes: bool = False, is_whole: bool = False
) -> Command:
    """Return the row of a figure with its MIN MAX DEF; ``reshapes`` marks what makes the trace stale."""
    words = {"MIN": figure.low, "MAX": figure.high, "DEF": figure.default}

    def write(call: Call, value: float | str) -> None:
        if isinstance(value, str) and value not in words:
            raise ScpiError(-141, value)
        wanted = words[value] if isinstance(value, str) else value
        stored = figure.limited(float(round(wanted)) if is_whole and math.isfinite(wanted) else wanted)
        call.instrument.functions.figures[figure.key(call)] = stored
        if reshapes:
            call.instrument.invalidate()
        if not figure.low <= wanted <= figure.high:
            raise ScpiError(-222, f"{wanted:g}")

    def query(call: Call, value: float | str = "") -> str:
        if not isinstance(value, str):
            raise ScpiError(-128)
        return number_text(words.get(value, figure.load(call)))

    return Command(pattern, write, query, (Numeric(units),), query_parameters=(Numeric(units),))


def hertz_row(pattern: str, figure: Figure, *, reshapes: bool = False) -> Command:
    """Return the row of a bandwidth, a span or a distance."""
    return figure_row(pattern, figure, HERTZ, reshapes=reshapes)


def decibel_row(pattern: str, figure: Figure) -> Command:
    """Return the row of a difference of levels."""
    return figure_row(pattern, figure, DECIBELS)


def word_row(pattern: str, name: str, words: tuple[str, ...], default: str) -> Command:
    """Return the row of a word out of a list; it leaves the trace valid."""

    def write(call: Call, value: str) -> None:
        call.instrument.functions.words[name] = value

    return Command(pattern, write, lambda call: word(call, name, default), (Choice(words),))


def switch_row(pattern: str, name: str, default: str = "0", *, reshapes: bool = False) -> Command:
    """Return the row of a switch; ``reshapes`` marks one that makes the trace stale."""

    def write(call: Call, is_on: bool) -> None:  # noqa: FBT001 - the one value of the command
        call.instrument.functions.words[name] = str(int(is_on))
        if reshapes:
            call.instrument.invalidate()

    return Command(pattern, write, lambda call: word(call, name, default), (Boolean(),))


def word(call: Call, name: str, default: str) -> str:
    """Return a word or a switch in force."""
    return call.instrument.functions.words.get(name, default)


def shown_level(call: Call, level_dbm: float) -> float:
    """Return a level, or a density, in the unit of the display; NaN stays."""
    return float(UNITS[call.instrument.settings.unit](np.array([level_dbm]))[0])


def result_text(value: float, missing: str = NOT_A_NUMBER) -> str:
    """Return one result.

    Examples
    --------
    >>> result_text(-40.125), result_text(float("nan")), result_text(1.0e9)
    ('-40.125', '9.91E37', '1000000000')
    """
    return f"{value:.12g}" if math.isfinite(value) else missing


def results(values: tuple[float, ...], missing: str = NOT_A_NUMBER) -> str:
    """Return several results, comma separated."""
    return ",".join(result_text(value, missing) for value in values)


def swept_trace(call: Call) -> Trace:
    """Return the trace shown, when it is one over frequency.

    Raises
    ------
    ScpiError
        -221 in zero span, -230 when no sweep has been taken with the present settings.
    """
    trace = call.instrument.trace()
    if trace.grid.spacing_hz <= 0.0:
        raise ScpiError(-221, "zero span")
    return trace


def middle_band(trace: Trace, width_hz: float) -> Band:
    """Return a band about the centre of the trace."""
    return Band(0.5 * (trace.grid.start_hz + trace.grid.stop_hz), width_hz)


def start_if_stale(call: Call) -> None:
    """Start a single sweep unless there is a trace with the present settings."""
    if call.instrument.settings.is_continuous:
        return
    try:
        call.instrument.trace()
    except ScpiError:
        start_sweep(call)


def start_sweep(call: Call) -> None:
    """Start a single sweep; an instrument that sweeps continuously needs none."""
    if not call.instrument.settings.is_continuous:
        call.instrument.initiate()
