"""Rows for settings: what is the same for every maker, made from a header and the name of a setting.

Law of this file: a setting that shapes the trace makes the trace stale; a value out of range is stored at its limit
and then reported as -222.
"""

from collections.abc import Callable, Mapping

from analyzer_sim.dialects.rows.command_row import Call, Command
from analyzer_sim.instrument.settings.instrument_settings import Settings
from analyzer_sim.instrument.settings.quantities import QUANTITIES, load, shown_limits, store
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import PURE, Boolean, Choice, Numeric, Parameter


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
