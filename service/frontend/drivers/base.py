"""Port of an analyzer driver, and the commands by which dialects differ.

Law of this package: a driver knows SCPI and nothing of carriers, rows or the service. It reads back every setting and
hands on the values that the analyzer states, and it never gives out a trace that the analyzer's error queue disowns.
"""

import re
from dataclasses import dataclass
from typing import NamedTuple

from service.core.radio.predicted_sigma import GAUSSIAN_ENBW_RATIO


class SweepRefusedError(Exception):
    """The analyzer refused a command; its own message is in the text."""


class Features(NamedTuple):
    """Optional queries that the analyzer answered when it was asked once."""

    #: the questionable-status register can be read
    has_status: bool
    #: ``SIM:EPOCH?`` gives the middle of the last dwell as RFC 3339 text; only a simulator knows it
    has_dwell_epoch: bool
    #: the analyzer has a calendar clock
    has_clock: bool


@dataclass(frozen=True, slots=True)
class Word:
    """A setting whose value is a word: sent once a session, read back with every sweep.

    Examples
    --------
    >>> Word(":UNIT:POW", "DBM").stands("DBMV"), Word(":AVER:TYPE", "POW", "POWER").stands('"power"')
    (False, True)
    """

    header: str
    value: str
    #: regular expression of further answers that mean the same
    also: str = "(?!)"
    #: levels are wrong without it: the analyzer is refused when it does not take it
    is_needed: bool = True

    def stands(self, answer: str) -> bool:
        """Return whether an answer says that the setting has this value."""
        said = answer.strip().strip("\"'").upper()
        return said == self.value or re.fullmatch(self.also, said) is not None


@dataclass(frozen=True, slots=True)
class TraceFormat:
    """One way in which a trace can be sent."""

    words: tuple[Word, ...]
    is_binary: bool = False
    is_big_endian: bool = False


#: as text: no byte order to be wrong about; Anritsu puts it into a block
ASCII = TraceFormat((Word(":FORM", "ASC", "ASC.*"),))
#: it sweeps when it is told to, or traces are of no sweep in particular
SINGLE = Word(":INIT:CONT", "OFF", "0")
#: no analyzer may answer in another unit
UNIT = Word(":UNIT:POW", "DBM")


@dataclass(frozen=True, slots=True)
class Dialect:
    """The words of one family of analyzers."""

    name: str
    #: regular expression found in "vendor,model" of ``*IDN?``; case is of no account
    identity: str
    #: means of powers: alternatives, the first that the analyzer takes is used
    detectors: tuple[tuple[Word, ...], ...]
    #: further settings that must not be left to chance
    method: tuple[Word, ...]
    #: in order of preference; the last one is text
    formats: tuple[TraceFormat, ...]
    trace_query: str
    points: str
    reference_level: str
    attenuation: str
    preamplifier: str
    #: application to be in before the reset; asked for first, as changing it takes seconds
    application: Word | None = None
    #: number of points of models that have no choice
    fixed_points: int | None = None
    #: ENBW over RBW of the resolution filters
    enbw_ratio: float = GAUSSIAN_ENBW_RATIO
    #: bits of the questionable-status register: overload, reference oscillator, uncalibrated sweep (SCPI-99, 20.3)
    power_bits: int = 1 << 3
    frequency_bits: int = 1 << 5
    calibration_bits: int = 1 << 8
    #: query that answers 1 once the sweep has ended, for families whose ``*OPC?`` may come before that
    sweep_end: str = ""
    #: gives the front panel back
    local: str = ":SYST:LOC"
