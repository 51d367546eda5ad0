"""Rows for settings: what is the same for every maker, made from a header and the name of a setting.

Law of this file: a setting that shapes the trace makes the trace stale; a value out of range is stored at its limit
and then reported as -222.
"""

from collections.abc import Callable, Mapping

from analyzer_sim.dialects.dialect import Call, Command
from analyzer_sim.instrument.instrument_settings import Settings
from analyzer_sim.instrument.quantities import QUANTITIES, load, shown_limits, store
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import DECIBELS, HERTZ, PURE, SECONDS, Boolean, Choice, Level, Numeric, Parameter


def number_text(value: float) -> str:
    """Return a setting as text, without unit.

    Examples
    --------
    >>> number_text(1.017e9), number_text(0.2), number_text(2401)
    ('1017000000', '0.2', '2401')
    """
    return f"{value:.12g}"


def _word_value(settings: Settings, name: str, word: str) -> float:
    """Return the value a keyword stands for."""
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


def boolean(pattern: str, attribute: str, freeze: Callable[[Settings], None] | None = None) -> Command:
    """Return the row of a switch; ``freeze`` keeps the value in force when a coupling is switched off."""

    def write(call: Call, value: bool) -> None:  # noqa: FBT001 - the one value of the command
        settings = call.instrument.settings
        if freeze is not None and not value:
            freeze(settings)
        setattr(settings, attribute, value)
        call.instrument.invalidate()

    def query(call: Call) -> str:
        return str(int(getattr(call.instrument.settings, attribute)))

    return Command(pattern, write, query, (Boolean(),))


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
    words = {"MIN": low, "MAX": high, "DEF": default}

    def wanted(value: float | str) -> float:
        if isinstance(value, str) and value not in words:
            raise ScpiError(-224, value)
        return words[value] if isinstance(value, str) else value

    def write(call: Call, value: float | str) -> None:
        clamped = min(max(wanted(value), low), high)
        call.instrument.settings.inert[pattern] = number_text(clamped)
        if clamped != wanted(value):
            raise ScpiError(-222, f"{value:g}")

    def query(call: Call, value: float | str = "") -> str:
        if not isinstance(value, str):
            raise ScpiError(-128)
        if value:
            return number_text(wanted(value))
        return call.instrument.settings.inert.get(pattern, number_text(default))

    return Command(pattern, write, query, (Numeric(units),), query_parameters=(Numeric(units),), is_inert=True)


def constant(pattern: str, answer: str) -> Command:
    """Return the row of a query whose answer never changes."""
    return Command(pattern, query=lambda _call: answer)


def ignored(pattern: str) -> Command:
    """Return the row of a command that is accepted and does nothing."""
    return Command(pattern, lambda _call: None, is_inert=True)


def freeze_rbw(settings: Settings) -> None:
    """Keep the resolution bandwidth in force when its coupling ends."""
    settings.rbw_chosen_hz = settings.rbw_shown_hz


def freeze_vbw(settings: Settings) -> None:
    """Keep the video bandwidth in force when its coupling ends."""
    settings.vbw_chosen_hz = settings.vbw_hz


def freeze_time(settings: Settings) -> None:
    """Keep the sweep time in force when its coupling ends."""
    settings.time_chosen_s = settings.time_s


def freeze_attenuation(settings: Settings) -> None:
    """Keep the attenuation in force when its coupling ends."""
    settings.attenuation_chosen_db = settings.attenuation_db


def frequency_rows(head: str, step: str) -> tuple[Command, ...]:
    """Return the rows of centre and its step, span, ends and offset."""
    settings = {"CENTer": "center_hz", step: "step_hz", "SPAN": "span_hz", "STARt": "start_hz", "STOP": "stop_hz"}
    settings["OFFSet"] = "offset_hz"
    rows = (numeric(f"{head}:{word}", name, HERTZ) for word, name in settings.items())
    return (*rows, full_span_row(f"{head}:SPAN:FULL"))


def bandwidth_rows(head: str) -> tuple[Command, ...]:
    """Return the rows of the filters and their couplings."""
    return (
        numeric(f"{head}[:RESolution]", "rbw_hz", HERTZ),
        boolean(f"{head}[:RESolution]:AUTO", "is_rbw_auto", freeze_rbw),
        numeric(f"{head}:VIDeo", "vbw_hz", HERTZ),
        numeric(f"{head}:VIDeo:RATio", "vbw_per_rbw"),
        boolean(f"{head}:VIDeo:AUTO", "is_vbw_auto", freeze_vbw),
    )


def sweep_time_rows(head: str) -> tuple[Command, ...]:
    """Return the rows of the sweep time and its coupling."""
    return (
        numeric(f"{head}:TIME", "time_s", SECONDS),
        boolean(f"{head}:TIME:AUTO", "is_time_auto", freeze_time),
    )


def level_rows(scale: str, attenuation: str, preamplifier: str) -> tuple[Command, ...]:
    """Return the rows of the reference level, its offset, attenuator and preamplifier."""
    return (
        numeric(f"{scale}:RLEVel", "reference_dbm", parameter=Level()),
        numeric(f"{scale}:RLEVel:OFFSet", "level_offset_db", DECIBELS),
        numeric(attenuation, "attenuation_db", DECIBELS),
        boolean(f"{attenuation}:AUTO", "is_attenuation_auto", freeze_attenuation),
        boolean(preamplifier, "is_preamplifier_on"),
    )


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
