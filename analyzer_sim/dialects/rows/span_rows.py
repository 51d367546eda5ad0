"""Rows that change the span by a key: full, zero, previous, halved and doubled."""

from analyzer_sim.dialects.rows.command_row import Call, Command
from analyzer_sim.instrument.settings.quantities import store
from analyzer_sim.scpi.parameters import Boolean


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
