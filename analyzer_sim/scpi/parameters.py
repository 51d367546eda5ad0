"""Data elements -> values of a command: what each kind of parameter accepts and which error it gives otherwise.

A kind is a small frozen object with ``read(data) -> value``. The error numbers follow SCPI-99, volume 2, 21.8: a type
that the command does not take is -128, -138, -148, -158 or -168; a word outside the list is -141; a suffix that does
not fit is -131.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parser import Block, Character, Datum, Number, Text, short_form

HERTZ: Mapping[str, float] = {"HZ": 1.0, "KHZ": 1e3, "MHZ": 1e6, "MAHZ": 1e6, "GHZ": 1e9}
SECONDS: Mapping[str, float] = {"S": 1.0, "MS": 1e-3, "US": 1e-6, "NS": 1e-9}
DECIBELS: Mapping[str, float] = {"DB": 1.0}
DBM: Mapping[str, float] = {"DBM": 1.0}
PURE: Mapping[str, float] = {}
#: level of 1 V at 50 ohm, dBm
_VOLT_DBM = 10.0 * math.log10(1e3 / 50.0)
#: suffix -> what is added to become dBm
_LOGARITHMIC_LEVELS: Mapping[str, float] = {
    "DBM": 0.0,
    "DBPW": -90.0,
    "DBV": _VOLT_DBM,
    "DBMV": _VOLT_DBM - 60.0,
    "DBUV": _VOLT_DBM - 120.0,
}
_VOLT = math.sqrt(1e3 / 50.0)
#: suffix -> factor and multiple of the logarithm that make dBm
_LINEAR_LEVELS: Mapping[str, tuple[float, float]] = {
    "W": (1e3, 10.0),
    "MW": (1.0, 10.0),
    "UW": (1e-3, 10.0),
    "V": (_VOLT, 20.0),
    "MV": (1e-3 * _VOLT, 20.0),
    "UV": (1e-6 * _VOLT, 20.0),
}

#: words that stand for a number, short and long form
KEYWORDS: Mapping[str, str] = {
    "MIN": "MIN", "MINIMUM": "MIN", "MAX": "MAX", "MAXIMUM": "MAX", "DEF": "DEF", "DEFAULT": "DEF",
    "UP": "UP", "DOWN": "DOWN", "INF": "INF", "INFINITY": "INF", "NINF": "NINF", "NINFINITY": "NINF",
}  # fmt: skip

_TYPE_NOT_ALLOWED: Mapping[type[Datum], int] = {Number: -128, Character: -148, Text: -158, Block: -168}


class Parameter(Protocol):
    """A kind of parameter."""

    def read(self, datum: Datum) -> object:
        """Return the value of one data element or raise :class:`ScpiError`."""


@dataclass(frozen=True, slots=True)
class Numeric:
    """A number with a unit, or one of the words MIN MAX DEF UP DOWN, which come back as such."""

    #: legal suffixes and what each multiplies by
    units: Mapping[str, float]

    def read(self, datum: Datum) -> float | str:
        """Return the number in the base unit, or the keyword."""
        if isinstance(datum, Character):
            return _keyword(datum)
        if not isinstance(datum, Number):
            raise ScpiError(_TYPE_NOT_ALLOWED[type(datum)])
        if not datum.suffix:
            return datum.value
        if not self.units:
            raise ScpiError(-138, datum.suffix)
        if datum.suffix not in self.units:
            raise ScpiError(-131, datum.suffix)
        return datum.value * self.units[datum.suffix]


def _keyword(datum: Character) -> float | str:
    keyword = KEYWORDS.get(datum.text)
    if keyword is None:
        raise ScpiError(-141, datum.text)
    return {"INF": math.inf, "NINF": -math.inf}.get(keyword, keyword)


@dataclass(frozen=True, slots=True)
class Level:
    """A level in any unit of power or, at 50 ohm, of voltage; without a suffix in dBm. Answers dBm or the keyword."""

    def read(self, datum: Datum) -> float | str:
        """Return the level, dBm; a power or a voltage that is not positive is minus infinity."""
        if not isinstance(datum, Number) or not datum.suffix:
            return Numeric(DBM).read(datum)
        if datum.suffix in _LOGARITHMIC_LEVELS:
            return datum.value + _LOGARITHMIC_LEVELS[datum.suffix]
        if datum.suffix not in _LINEAR_LEVELS:
            raise ScpiError(-131, datum.suffix)
        factor, exponent = _LINEAR_LEVELS[datum.suffix]
        return exponent * math.log10(datum.value * factor) if datum.value > 0.0 else -math.inf


@dataclass(frozen=True, slots=True)
class Boolean:
    """ON, OFF or a number; a number is true when it rounds to anything but zero."""

    def read(self, datum: Datum) -> bool:
        """Return the truth value."""
        if isinstance(datum, Number):
            if datum.suffix:
                raise ScpiError(-138, datum.suffix)
            return abs(datum.value) >= 0.5
        if not isinstance(datum, Character):
            raise ScpiError(_TYPE_NOT_ALLOWED[type(datum)])
        if datum.text not in {"ON", "OFF"}:
            raise ScpiError(-141, datum.text)
        return datum.text == "ON"


@dataclass(frozen=True, slots=True)
class Choice:
    """One word of a list, short or long form; answers are short."""

    #: words as manuals write them: ``POSitive``
    words: tuple[str, ...]

    def read(self, datum: Datum) -> str:
        """Return the short form of the word."""
        if not isinstance(datum, Character):
            raise ScpiError(_TYPE_NOT_ALLOWED[type(datum)])
        for word in self.words:
            if datum.text in {short_form(word), word.upper()}:
                return short_form(word)
        raise ScpiError(-141, datum.text)


@dataclass(frozen=True, slots=True)
class TraceName:
    """A trace by its number or by a word with a number at its end: ``1``, ``TRACE1``, ``TRC1``; answers the number."""

    #: words that may stand before the number
    prefixes: tuple[str, ...]
    highest: int
    #: the number alone is enough
    is_number_legal: bool = True

    def read(self, datum: Datum) -> int:
        """Return the number of the trace."""
        if isinstance(datum, Number) and self.is_number_legal:
            return self._number(datum.value, datum.suffix)
        if not isinstance(datum, Character):
            raise ScpiError(_TYPE_NOT_ALLOWED[type(datum)])
        prefix = datum.text.rstrip("0123456789")
        digits = datum.text[len(prefix) :]
        if prefix not in self.prefixes or not 0 < len(digits) < 4 or not 1 <= int(digits) <= self.highest:
            raise ScpiError(-141, datum.text)
        return int(digits)

    def _number(self, value: float, suffix: str) -> int:
        if suffix:
            raise ScpiError(-138, suffix)
        if value not in range(1, self.highest + 1):
            raise ScpiError(-224, f"{value:g}")
        return int(value)


@dataclass(frozen=True, slots=True)
class Quoted:
    """A string, or a bare word where clients leave the quotes out."""

    def read(self, datum: Datum) -> str:
        """Return the text."""
        if isinstance(datum, Text | Character):
            return datum.text
        raise ScpiError(_TYPE_NOT_ALLOWED[type(datum)])
