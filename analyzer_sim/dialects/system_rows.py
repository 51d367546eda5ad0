"""Commands that every dialect has: IEEE 488.2, the status, system and abort part of SCPI-99, panel and clock."""

from collections.abc import Callable

from analyzer_sim.dialects.dialect import Call, Command
from analyzer_sim.dialects.settings_rows import ignored
from analyzer_sim.epochs import rfc3339
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import PURE, Numeric
from analyzer_sim.scpi.status import REGISTER_MASK, StatusModel, StatusRegister

_MASK = Numeric(PURE)


def _mask_value(value: float | str, limit: int) -> int:
    if isinstance(value, str):
        raise ScpiError(-148, value)
    if not -0.5 <= value < limit + 0.5:
        raise ScpiError(-222, f"{value:g}")
    return round(value)


def _clear(call: Call) -> None:
    call.instrument.status.clear()


def _reset(call: Call) -> None:
    call.instrument.reset()


def _preset(call: Call) -> None:
    call.instrument.reset(is_preset=True)


def _put_event_enable(call: Call, value: float | str) -> None:
    call.instrument.status.event_enable = _mask_value(value, 255)


def _put_service_enable(call: Call, value: float | str) -> None:
    call.instrument.status.service_enable = _mask_value(value, 255) & ~0x40


def _complete(call: Call) -> None:
    call.instrument.report_completion()


def _initiate(call: Call) -> None:
    call.instrument.initiate()


def _abort(call: Call) -> None:
    call.instrument.abort()


def _wait(_call: Call) -> None:
    """Nothing is left to do once the row's ``write_waits`` let the unit through."""


def _status_byte(call: Call) -> str:
    return str(call.instrument.status.status_byte(has_response=call.has_response))


COMMON_COMMANDS: tuple[Command, ...] = (
    Command("*CLS", _clear),
    Command("*RST", _reset),
    Command("*ESE", _put_event_enable, lambda call: str(call.instrument.status.event_enable), (_MASK,)),
    Command("*ESR", query=lambda call: str(call.instrument.status.pop_event())),
    Command("*SRE", _put_service_enable, lambda call: str(call.instrument.status.service_enable), (_MASK,)),
    Command("*STB", query=_status_byte),
    Command("*OPC", _complete, lambda _call: "1", query_waits=True),
    Command("*WAI", _wait, write_waits=True),
    Command("*TST", query=lambda _call: "0"),
    Command("*TRG", _initiate),
)

_REGISTERS: tuple[tuple[str, Callable[[StatusModel], StatusRegister]], ...] = (
    ("STATus:OPERation", lambda status: status.operation),
    ("STATus:QUEStionable", lambda status: status.questionable),
    ("STATus:QUEStionable:POWer", lambda status: status.questionable_power),
)


def register_rows(pattern: str, register_of: Callable[[StatusModel], StatusRegister]) -> tuple[Command, ...]:
    """Return the rows of one SCPI status register."""

    def put_enable(call: Call, value: float | str) -> None:
        register_of(call.instrument.status).put_enable(_mask_value(value, 65535))

    def put_rising(call: Call, value: float | str) -> None:
        register_of(call.instrument.status).rising = _mask_value(value, 65535) & REGISTER_MASK

    def put_falling(call: Call, value: float | str) -> None:
        register_of(call.instrument.status).falling = _mask_value(value, 65535) & REGISTER_MASK

    return (
        Command(f"{pattern}[:EVENt]", query=lambda call: str(register_of(call.instrument.status).pop_event())),
        Command(f"{pattern}:CONDition", query=lambda call: str(register_of(call.instrument.status).condition)),
        Command(
            f"{pattern}:ENABle",
            put_enable,
            lambda call: str(register_of(call.instrument.status).enable),
            (_MASK,),
        ),
        Command(
            f"{pattern}:PTRansition",
            put_rising,
            lambda call: str(register_of(call.instrument.status).rising),
            (_MASK,),
        ),
        Command(
            f"{pattern}:NTRansition",
            put_falling,
            lambda call: str(register_of(call.instrument.status).falling),
            (_MASK,),
        ),
    )


def _preset_status(call: Call) -> None:
    call.instrument.status.preset()


SYSTEM_COMMANDS: tuple[Command, ...] = (
    *(row for pattern, register_of in _REGISTERS for row in register_rows(pattern, register_of)),
    Command("STATus:PRESet", _preset_status),
    Command("SYSTem:ERRor[:NEXT]", query=lambda call: call.instrument.status.pop_error()),
    Command("SYSTem:ERRor:ALL", query=lambda call: call.instrument.status.pop_all_errors()),
    Command("SYSTem:ERRor:CLEar[:ALL]", lambda call: call.instrument.status.errors.clear()),
    Command("SYSTem:ERRor:COUNt", query=lambda call: str(call.instrument.status.error_count)),
    Command("SYSTem:VERSion", query=lambda _call: "1999.0"),
    Command("SYSTem:PRESet", _preset),
    Command("ABORt", _abort),
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
