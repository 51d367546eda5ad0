"""Rows of sweeps and of the system that several dialects share."""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from analyzer_sim.dialects.dialect import Call, Command
from analyzer_sim.dialects.settings_rows import ignored, switch
from analyzer_sim.epochs import rfc3339
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import PURE, Choice, Numeric, Quoted
from analyzer_sim.scpi.parser import short_form
from analyzer_sim.scpi.status import REGISTER_MASK, StatusModel, StatusRegister

#: code of a detector whose kind of mean the average type decides
BY_TYPE: Final = "BY TYPE"
#: average type -> detector of the same mean
AVERAGING_DETECTORS: Mapping[str, str] = {"VID": "AVER", "POW": "RMS", "LIN": "LIN"}
#: widths of a Gaussian filter by the one at 3 dB: at 6 dB, of noise, of impulses
DB6_RATIO: Final = math.sqrt(2.0)
NOISE_RATIO: Final = math.sqrt(math.pi / (4.0 * math.log(2.0)))
IMPULSE_RATIO: Final = math.sqrt(math.pi / (2.0 * math.log(2.0)))


def filter_type_row(pattern: str, ratios: Mapping[str, float]) -> Command:
    """Return the row that tells by which width the resolution filter is set: word -> that width by the 3 dB one."""
    ratio_of = {short_form(word): ratio for word, ratio in ratios.items()}

    def write(call: Call, word: str) -> None:
        call.instrument.settings.filter_ratio = ratio_of[word]
        call.instrument.invalidate()

    def query(call: Call) -> str:
        return next(word for word, ratio in ratio_of.items() if ratio == call.instrument.settings.filter_ratio)

    return Command(pattern, write, query, (Choice(tuple(ratios)),))


def detector_rows(pattern: str, auto: str, codes: Mapping[str, str]) -> tuple[Command, ...]:
    """Return the rows of the detector and of its automatic choice.

    Parameters
    ----------
    pattern, auto : str
        Headers.
    codes : mapping
        Word of the dialect -> code of ``Settings.detector``, or ``BY_TYPE``.
    """
    code_of = {short_form(word): code for word, code in codes.items()}
    word_of = {code: word for word, code in reversed(code_of.items())}
    if BY_TYPE in word_of:
        word_of.update(dict.fromkeys(AVERAGING_DETECTORS.values(), word_of[BY_TYPE]))

    def write(call: Call, word: str) -> None:
        settings = call.instrument.settings
        code = code_of[word]
        settings.detector = AVERAGING_DETECTORS[settings.average_type] if code == BY_TYPE else code
        settings.is_detector_auto = False
        call.instrument.invalidate()

    def write_auto(call: Call, is_auto: bool) -> None:  # noqa: FBT001 - the one value of the command
        settings = call.instrument.settings
        settings.is_detector_auto = is_auto
        if is_auto:
            settings.detector = settings.model.detector
        call.instrument.invalidate()

    return (
        Command(pattern, write, lambda call: word_of[call.instrument.settings.detector], (Choice(tuple(codes)),)),
        switch(auto, write_auto, lambda call: call.instrument.settings.is_detector_auto),
    )


def average_type_row(pattern: str, types: Mapping[str, str], *, does_detector_follow: bool = False) -> Command:
    """Return the row of the average type: word of the dialect -> code of ``Settings.average_type``."""
    type_of = {short_form(word): code for word, code in types.items()}
    word_of = {code: word for word, code in type_of.items()}

    def write(call: Call, word: str) -> None:
        settings = call.instrument.settings
        if does_detector_follow and settings.detector in AVERAGING_DETECTORS.values():
            settings.detector = AVERAGING_DETECTORS[type_of[word]]
        settings.average_type = type_of[word]
        call.instrument.invalidate()

    return Command(pattern, write, lambda call: word_of[call.instrument.settings.average_type], (Choice(tuple(types)),))


def trace_mode_row(pattern: str, plain: str) -> Command:
    """Return the row that shows a single sweep, or the average, the highest or the lowest of several."""

    def write(call: Call, word: str) -> None:
        settings = call.instrument.settings
        settings.is_averaging = word != short_form(plain)
        settings.hold = word if word in {"MAXH", "MINH"} else ""
        call.instrument.invalidate()

    def query(call: Call) -> str:
        settings = call.instrument.settings
        return (settings.hold or "AVER") if settings.is_averaging else short_form(plain)

    return Command(pattern, write, query, (Choice((plain, "AVERage", "MAXHold", "MINHold")),))


def average_state_row(pattern: str) -> Command:
    """Return the row that switches the average of several sweeps on; a hold ends."""

    def write(call: Call, is_on: bool) -> None:  # noqa: FBT001 - the one value of the command
        call.instrument.settings.is_averaging, call.instrument.settings.hold = is_on, ""
        call.instrument.invalidate()

    def is_averaging(call: Call) -> bool:
        return call.instrument.settings.is_averaging and not call.instrument.settings.hold

    return switch(pattern, write, is_averaging)


def unit_row(
    pattern: str,
    units: tuple[str, ...],
    conflicting: tuple[str, ...] = (),
    synonyms: Mapping[str, str] = MappingProxyType({}),
) -> Command:
    """Return the row of the unit of levels.

    ``conflicting`` units need a set-up that this instrument does not have; ``synonyms`` are other words for units.
    """
    unit_of = {short_form(word): unit for word, unit in synonyms.items()}

    def write(call: Call, unit: str) -> None:
        if unit in conflicting:
            raise ScpiError(-221, f"{unit} needs an antenna factor")
        call.instrument.settings.unit = unit_of.get(unit, unit)

    words = (*units, *synonyms, *conflicting)
    return Command(pattern, write, lambda call: call.instrument.settings.unit, (Choice(words),))


def _put_continuous(call: Call, is_on: bool) -> None:  # noqa: FBT001 - the one value of the command
    if is_on:
        call.instrument.abort()
    call.instrument.settings.is_continuous = is_on


def initiate_row(pattern: str) -> Command:
    """Return the row that starts a sweep."""
    return Command(pattern, lambda call: call.instrument.initiate())


def continuous_row(pattern: str) -> Command:
    """Return the row that sweeps without end."""
    return switch(pattern, _put_continuous, lambda call: call.instrument.settings.is_continuous)


def application_row(pattern: str, answer: str, names: frozenset[str]) -> Command:
    """Return the row that selects the only application there is: ``names`` in upper case are accepted."""

    def write(_call: Call, name: str) -> None:
        if name.upper() not in names:
            raise ScpiError(-224, name)

    return Command(pattern, write, lambda _call: answer, (Quoted(),))


_MASK = Numeric(PURE)


def _mask_value(value: float | str, limit: int) -> int:
    if isinstance(value, str):
        raise ScpiError(-148, value)
    if not -0.5 <= value < limit + 0.5:
        raise ScpiError(-222, f"{value:g}")
    return round(value)


def _put_event_enable(call: Call, value: float | str) -> None:
    call.instrument.status.event_enable = _mask_value(value, 255)


def _put_service_enable(call: Call, value: float | str) -> None:
    call.instrument.status.service_enable = _mask_value(value, 255) & ~0x40


COMMON_COMMANDS: tuple[Command, ...] = (
    Command("*CLS", lambda call: call.instrument.status.clear()),
    Command("*RST", lambda call: call.instrument.reset()),
    Command("*ESE", _put_event_enable, lambda call: str(call.instrument.status.event_enable), (_MASK,)),
    Command("*ESR", query=lambda call: str(call.instrument.status.pop_event())),
    Command("*SRE", _put_service_enable, lambda call: str(call.instrument.status.service_enable), (_MASK,)),
    Command("*STB", query=lambda call: str(call.instrument.status.status_byte(has_response=call.has_response))),
    Command("*OPC", lambda call: call.instrument.report_completion(), lambda _call: "1", query_waits=True),
    # nothing is left to do once the row has let the unit through
    Command("*WAI", lambda _call: None, write_waits=True),
    Command("*TST", query=lambda _call: "0"),
    Command("*TRG", lambda call: call.instrument.initiate()),
)

_REGISTERS: tuple[tuple[str, Callable[[StatusModel], StatusRegister]], ...] = (
    ("STATus:OPERation", lambda status: status.operation),
    ("STATus:QUEStionable", lambda status: status.questionable),
    ("STATus:QUEStionable:POWer", lambda status: status.questionable_power),
)


def register_rows(pattern: str, register_of: Callable[[StatusModel], StatusRegister]) -> tuple[Command, ...]:
    """Return the rows of one SCPI status register."""

    def mask_row(word: str, name: str) -> Command:
        def put(call: Call, value: float | str) -> None:
            setattr(register_of(call.instrument.status), name, _mask_value(value, 65535) & REGISTER_MASK)

        def query(call: Call) -> str:
            return str(getattr(register_of(call.instrument.status), name))

        return Command(f"{pattern}:{word}", put, query, (_MASK,))

    masks = {"ENABle": "enable", "PTRansition": "rising", "NTRansition": "falling"}
    return (
        Command(f"{pattern}[:EVENt]", query=lambda call: str(register_of(call.instrument.status).pop_event())),
        Command(f"{pattern}:CONDition", query=lambda call: str(register_of(call.instrument.status).condition)),
        *(mask_row(word, name) for word, name in masks.items()),
    )


SYSTEM_COMMANDS: tuple[Command, ...] = (
    *(row for pattern, register_of in _REGISTERS for row in register_rows(pattern, register_of)),
    Command("STATus:PRESet", lambda call: call.instrument.status.preset()),
    Command("SYSTem:ERRor[:NEXT]", query=lambda call: call.instrument.status.pop_error()),
    Command("SYSTem:ERRor:ALL", query=lambda call: call.instrument.status.pop_all_errors()),
    Command("SYSTem:ERRor:CLEar[:ALL]", lambda call: call.instrument.status.errors.clear()),
    Command("SYSTem:ERRor:COUNt", query=lambda call: str(call.instrument.status.error_count)),
    Command("SYSTem:VERSion", query=lambda _call: "1999.0"),
    Command("SYSTem:PRESet", lambda call: call.instrument.reset(is_preset=True)),
    Command("ABORt", lambda call: call.instrument.abort()),
)


def _date(call: Call) -> str:
    year, month, day = rfc3339(call.instrument.epoch_us())[:10].split("-")
    return f"{year},{int(month)},{int(day)}"


def _time(call: Call) -> str:
    hour, minute, second = rfc3339(call.instrument.epoch_us())[11:19].split(":")
    return f"{int(hour)},{int(minute)},{int(second)}"


#: the clock of the instrument is that of the world; ``SIMulation:EPOCh?`` is the simulator's own
CLOCK_ROWS: tuple[Command, ...] = (
    Command("SYSTem:DATE", query=_date),
    Command("SYSTem:TIME", query=_time),
    Command("SIMulation:EPOCh", query=lambda call: rfc3339(call.instrument.epoch_us())),
)

#: hand-over between front panel and line, and the clock
LOCAL_ROWS = (ignored("SYSTem:LOCal"), ignored("SYSTem:REMote"), *CLOCK_ROWS)
