"""Dialects: the commands by which analyzers differ, and the choice of one by the answer to ``*IDN?``."""

import re
from dataclasses import dataclass
from typing import NamedTuple

from service.core.radio.carrier_power import GAUSSIAN_ENBW_RATIO
from service.frontend.drivers.scpi import AnswerError, Identity, parse_identity
from service.frontend.drivers.visa_session import AnalyzerIOError, VisaSession


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


ANRITSU = Dialect(
    name="anritsu",
    identity=r"^anritsu",
    detectors=((Word(":DET", "RMS"),),),
    method=(
        UNIT,
        Word(":TRAC1:TYPE", "NORM", "NORMAL|WRIT|WRITE", is_needed=False),
        Word(":AVER:TYPE", "NONE", is_needed=False),
    ),
    formats=(ASCII,),
    trace_query=":TRAC:DATA? 1",
    points=":DISP:POIN",
    reference_level=":DISP:WIND:TRAC:Y:SCAL:RLEV",
    attenuation=":POW:RF:ATT",
    preamplifier=":POW:RF:GAIN:STAT",
    local="",
)


GENERIC = Dialect(
    name="generic",
    identity="",
    detectors=(
        (Word(":DET", "RMS"),),
        (Word(":DET", "AVER", "AVERAGE"), Word(":AVER:TYPE", "RMS")),
        (Word(":DET", "AVER", "AVERAGE"), Word(":AVER:TYPE", "POW", "POWER")),
    ),
    method=(UNIT,),
    formats=(ASCII,),
    trace_query=":TRAC:DATA? TRACE1",
    points=":SWE:POIN",
    reference_level=":DISP:WIND:TRAC:Y:SCAL:RLEV",
    attenuation=":POW:ATT",
    preamplifier=":POW:GAIN:STAT",
    local="",
)


KEYSIGHT = Dialect(
    name="keysight",
    identity=r"^(keysight|agilent|hewlett|hp\b)",
    detectors=((Word(":DET:TRAC", "AVER", "AVERAGE"), Word(":AVER:TYPE", "RMS")),),
    method=(
        UNIT,
        Word(":TRAC:TYPE", "WRIT", "WRITE"),
        Word(":BAND:TYPE", "DB3", is_needed=False),
        Word(":SWE:TYPE", "SWE", "SWEEP", is_needed=False),
    ),
    formats=(
        TraceFormat(
            (Word(":FORM:BORD", "NORM", "NORMAL"), Word(":FORM", "REAL,32", r"REAL,\+?32")),
            is_binary=True,
            is_big_endian=True,
        ),
        ASCII,
    ),
    trace_query=":TRAC? TRACE1",
    points=":SWE:POIN",
    reference_level=":DISP:WIND:TRAC:Y:RLEV",
    attenuation=":POW:ATT",
    preamplifier=":POW:GAIN",
    application=Word(":INST", "SA", is_needed=False),
    calibration_bits=(1 << 8) | (1 << 9),
    local="",
)


RS = Dialect(
    name="rs",
    identity=r"^(rohde|r\s*&\s*s\b|hameg)",
    detectors=((Word(":DET", "RMS"),),),
    method=(
        UNIT,
        Word(":DISP:TRAC:MODE", "WRIT", "WRITE"),
        Word(":BAND:TYPE", "NORM", "NORMAL", is_needed=False),
        Word(":SWE:TYPE", "SWE", "SWEEP", is_needed=False),
        Word(":SWE:COUN", "1", is_needed=False),
    ),
    formats=(TraceFormat((Word(":FORM", "REAL,32"),), is_binary=True), ASCII),
    trace_query=":TRAC? TRACE1",
    points=":SWE:POIN",
    reference_level=":DISP:TRAC:Y:RLEV",
    attenuation=":INP:ATT",
    preamplifier=":INP:GAIN:STAT",
    application=Word(":INST", "SAN", "SANALYZER", is_needed=False),
)


SIGLENT = Dialect(
    name="siglent",
    identity=r"^(siglent|teledyne\s*test|lecroy)|,(ssa|sva|t3sa)\d",
    detectors=((Word(":DET:TRAC1", "AVER", "AVERAGE"), Word(":AVER:TYPE", "POW", "POWER")),),
    method=(
        UNIT,
        Word(":TRAC1:MODE", "WRIT", "WRITE"),
        Word(":SWE:MODE", "SWE", "SWEEP", is_needed=False),
        Word(":FILT:TYPE", "GAUSS", is_needed=False),
    ),
    formats=(ASCII,),
    trace_query=":TRAC:DATA? 1",
    points=":SWE:POIN",
    reference_level=":DISP:WIND:TRAC:Y:RLEV",
    attenuation=":POW:ATT",
    preamplifier=":POW:GAIN",
    fixed_points=751,
    sweep_end=":TRAC:SWE:STAT? 1",
    local="",
)


#: in the order in which they are tried; the last fits all
DIALECTS: tuple[Dialect, ...] = (RS, KEYSIGHT, ANRITSU, SIGLENT, GENERIC)


def dialect_of(identity: Identity, named: str = "auto") -> Dialect:
    """Return the dialect that fits the identity, or the one that the task names.

    Examples
    --------
    >>> dialect_of(Identity("Rohde&Schwarz", "FSW-26", "1", "5.30")).name
    'rs'
    >>> dialect_of(Identity("Agilent Technologies", "N9010A", "MY1", "A.14")).name
    'keysight'
    """
    who = f"{identity.vendor},{identity.model}"
    for dialect in DIALECTS:
        if named == dialect.name or (named == "auto" and re.search(dialect.identity, who, re.IGNORECASE)):
            return dialect
    message = f"there is no dialect {named!r}"
    raise ValueError(message)


def identify(session: VisaSession) -> Identity:
    """Return the identity that the analyzer states.

    Raises
    ------
    AnalyzerIOError
        It says nothing, or something else.
    """
    try:
        return parse_identity(session.query("*IDN?"))
    except AnswerError as error:
        raise AnalyzerIOError(f"{session.resource}: {error}") from error
