"""Rohde & Schwarz: rows of the list of power measurements, ``[SENSe:]LIST:POWer``.

The command starts the list; the query starts it and answers when every entry has been measured; ``RESult?`` answers
again. Each entry answers up to three levels: those that ``SET`` switches on, in its order.
"""

from analyzer_sim.dialects.rows.command_row import Call, Command
from analyzer_sim.dialects.rows.function_rows import results, shown_level, word
from analyzer_sim.instrument.functions.power_list import EVALUATIONS, MAX_ENTRIES, entry_settings, read_entries
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import SECONDS, Boolean, Choice, Numeric
from analyzer_sim.scpi.parser import Datum

_LIST = "[SENSe<6>]:LIST:POWer"
_LEAST_FIELDS, _MOST_FIELDS = 8, 9
#: peak, RMS and average as they are after ``*RST``
_SWITCHES = ("list peak", "list rms", "list average")
_SWITCH_DEFAULTS = ("0", "1", "0")
_TRIGGER = ("list trigger", "list slope", "list offset", "list gate")
_TRIGGER_DEFAULTS = ("IMM", "POS", "0", "0")


class _AnyDatum:
    """A field of an entry, read later, when it is known which one it is."""

    def read(self, datum: Datum) -> Datum:
        """Return the element as it is."""
        return datum


_FIELDS = (_AnyDatum(),) * (_MOST_FIELDS * MAX_ENTRIES)


def _detectors(call: Call) -> list[str]:
    """Return the detectors of the evaluations that are on."""
    states = [word(call, name, default) for name, default in zip(_SWITCHES, _SWITCH_DEFAULTS, strict=True)]
    return [evaluation.detector for evaluation, state in zip(EVALUATIONS, states, strict=True) if state == "1"]


def _start(call: Call, *fields: Datum) -> None:
    settings = call.instrument.settings
    detectors = _detectors(call)
    if not detectors:
        raise ScpiError(-221, "no result is switched on")
    entries = read_entries(fields)
    sweeps = [entry_settings(settings, entry, detector) for entry in entries for detector in detectors]
    call.instrument.initiate_list(tuple(sweeps))


def _levels(call: Call, *_fields: Datum) -> str:
    traces = call.instrument.list_traces()
    combine = {evaluation.detector: evaluation.combine for evaluation in EVALUATIONS}
    return results(tuple(shown_level(call, combine[trace.detector](trace)) for trace in traces))


def _put_set(call: Call, *values: object) -> None:
    """Store what is evaluated; only the free-running trigger exists."""
    switches, trigger = values[: len(_SWITCHES)], values[len(_SWITCHES) :]
    words = call.instrument.functions.words
    source, slope, *times = trigger
    if any(isinstance(time, str) for time in times):
        raise ScpiError(-141)
    words.update(zip(_TRIGGER, (str(source), str(slope), *(f"{time:g}" for time in times)), strict=True))
    words.update({name: str(int(bool(value))) for name, value in zip(_SWITCHES, switches, strict=True)})
    call.instrument.invalidate()


def _set(call: Call) -> str:
    names, defaults = (*_SWITCHES, *_TRIGGER), (*_SWITCH_DEFAULTS, *_TRIGGER_DEFAULTS)
    return ",".join(word(call, name, default) for name, default in zip(names, defaults, strict=True))


def _switch_off(call: Call, is_on: bool) -> None:  # noqa: FBT001 - the one value of the command
    if is_on:
        raise ScpiError(-224, "a list is started by its entries")
    call.instrument.invalidate()


POWER_LIST_ROWS: tuple[Command, ...] = (
    Command(
        f"{_LIST}[:SEQuence]",
        _start,
        _levels,
        parameters=_FIELDS,
        optional=len(_FIELDS) - _LEAST_FIELDS,
        query_parameters=_FIELDS,
        query_required=_LEAST_FIELDS,
        query_waits=True,
        query_starts=_start,
    ),
    Command(f"{_LIST}:RESult", query=_levels, query_waits=True),
    Command(
        f"{_LIST}:SET",
        _put_set,
        _set,
        (
            Boolean(),
            Boolean(),
            Boolean(),
            Choice(("IMMediate",)),
            Choice(("POSitive", "NEGative")),
            Numeric(SECONDS),
            Numeric(SECONDS),
        ),
    ),
    Command(f"{_LIST}:STATe", _switch_off, lambda _call: "0", (Boolean(),)),
)
