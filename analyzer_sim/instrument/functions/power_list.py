"""List of power measurements: entries of a program message -> settings of short sweeps -> peak, mean power, mean level.

An entry is one frequency with its own level, attenuation, filters and time, measured without sweeping (zero span). Its
fields, as R&S analyzers take them::

    frequency, reference level, attenuation, [electronic attenuation | OFF,] filter type, RBW, VBW, time, trigger level

The electronic attenuation is told by its place: where it stands the filter type is the fifth field, else the fourth.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from analyzer_sim.instrument.functions.band_power import decibels, milliwatts_of
from analyzer_sim.instrument.painter import Trace
from analyzer_sim.instrument.settings.instrument_settings import Settings
from analyzer_sim.instrument.settings.quantities import store
from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parameters import DBM, DECIBELS, HERTZ, PURE, SECONDS, Choice, Numeric
from analyzer_sim.scpi.parser import Character, Datum

MAX_ENTRIES = 200
#: longest time of one entry, s; shortest as R&S analyzers have it
TIME_RANGE_S = (1e-6, 16000.0)
#: points of the short sweep: about four per RBW and second, between these
_POINTS_RANGE = (2, 101)
_FILTER_TYPE = Choice(("NORMal", "CFILter", "RRC", "P5", "PULSe"))
_FIELDS = 8


class ListEntry(NamedTuple):
    """One entry."""

    frequency_hz: float
    reference_dbm: float
    attenuation_db: float
    rbw_hz: float
    vbw_hz: float
    time_s: float


def read_entries(data: Sequence[Datum]) -> tuple[ListEntry, ...]:
    """Return the entries of a list.

    Raises
    ------
    ScpiError
        -109 a field is missing, -223 more than 200 entries, and what the fields themselves give.
    """
    width = _FIELDS
    if len(data) > _FIELDS and not _is_filter_type(data[3]):
        width += 1
    if not data or len(data) % width:
        raise ScpiError(-109, f"entries have {width} fields")
    if len(data) // width > MAX_ENTRIES:
        raise ScpiError(-223, f"{MAX_ENTRIES} entries at most")
    return tuple(_entry(data[first : first + width]) for first in range(0, len(data), width))


def _is_filter_type(datum: Datum) -> bool:
    return isinstance(datum, Character) and datum.text not in {"ON", "OFF"}


def _entry(fields: Sequence[Datum]) -> ListEntry:
    filter_type, rbw, vbw, time, trigger = fields[-5:]
    _FILTER_TYPE.read(filter_type)
    _number(trigger, PURE)
    time_s = _number(time, SECONDS)
    if not TIME_RANGE_S[0] <= time_s <= TIME_RANGE_S[1]:
        raise ScpiError(-222, f"{time_s:g}")
    return ListEntry(
        _number(fields[0], HERTZ),
        _number(fields[1], DBM),
        _number(fields[2], DECIBELS),
        _number(rbw, HERTZ),
        _number(vbw, HERTZ),
        time_s,
    )


def _number(datum: Datum, units: Mapping[str, float]) -> float:
    value = Numeric(units).read(datum)
    if isinstance(value, str):
        raise ScpiError(-141, value)
    return value


def entry_settings(settings: Settings, entry: ListEntry, detector: str) -> Settings:
    """Return the settings one entry is measured with.

    Raises
    ------
    ScpiError
        -222 a field is outside the range of the instrument.
    """
    changed = replace(settings, detector=detector, count=0, is_averaging=False)
    fields = entry._asdict()
    is_clamped = store(changed, "span_hz", 0.0)
    for name in ("reference_dbm", "attenuation_db", "rbw_hz", "vbw_hz"):
        is_clamped |= store(changed, name, fields[name])
    is_clamped |= store(changed, "center_hz", entry.frequency_hz)
    if is_clamped:
        raise ScpiError(-222, f"{entry.frequency_hz:g}")
    changed.time_chosen_s, changed.is_time_auto = entry.time_s, False
    low, high = _POINTS_RANGE
    changed.points = min(max(math.ceil(4.0 * changed.rbw_hz * entry.time_s), low), high)
    return changed


class Evaluation(NamedTuple):
    """One result of an entry; each is measured on a sweep of its own."""

    detector: str
    #: result from the points of the short sweep, dBm
    combine: Callable[[Trace], float]


#: in the order ``LIST:POWer:SET`` switches them: highest power, mean of mW, mean of dB (2.51 dB low on noise)
EVALUATIONS = (
    Evaluation("POS", lambda trace: float(trace.level_dbm.max())),
    Evaluation("RMS", lambda trace: decibels(float(milliwatts_of(trace.level_dbm).mean()))),
    Evaluation("AVER", lambda trace: float(trace.level_dbm.mean())),
)
