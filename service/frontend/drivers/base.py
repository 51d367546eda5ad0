"""What the acquisition asks of an analyzer, and the words by which dialects differ.

Law of this package: a driver knows SCPI and nothing of carriers, rows or the service. It reads back every setting and
hands on the values that the analyzer states, and it never gives out a trace that the analyzer's error queue disowns.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

from service.frontend.measurement_task import InputPart, SweepPart
from service.frontend.scpi import Identity
from service.records.sweep import Sweep, SweepSettings


class SweepRefusedError(Exception):
    """The analyzer answered, but did not do what it was told; its own words are in the text."""


class Features(NamedTuple):
    """Optional queries that the analyzer answered when it was asked once."""

    #: the questionable-status register can be read
    has_status: bool
    #: ``SIM:EPOCH?`` gives the middle of the last dwell as RFC 3339 text; only a simulator knows it
    has_dwell_epoch: bool
    #: the analyzer has a calendar clock
    has_clock: bool


@dataclass(frozen=True, slots=True)
class Dialect:
    """The words of one family of analyzers."""

    name: str
    #: part of the vendor field of ``*IDN?``, lower case; empty fits all
    vendor: str
    #: how a REAL,32 trace is asked for; empty: traces are read as ASCII
    binary_format: str
    is_big_endian: bool
    trace_query: str
    reference_level: str
    attenuation: str
    preamplifier: str
    #: ENBW over RBW of the resolution filters
    enbw_ratio: float


class Analyzer(Protocol):
    """One analyzer that answers; made by `service.frontend.drivers.choice.open_analyzer`."""

    @property
    def identity(self) -> Identity:
        """Answer to ``*IDN?``."""
        ...

    @property
    def features(self) -> Features:
        """What it can be asked for."""
        ...

    def preset(self) -> None:
        """Bring the analyzer into a known state: once a session."""
        ...

    def configure(self, sweep: SweepPart, path: InputPart) -> SweepSettings:
        """Send the settings that changed; return those that the analyzer states."""
        ...

    def take(self, sweep: SweepPart) -> Sweep:
        """Sweep with the settings configured last and return the trace."""
        ...

    def close(self) -> None:
        """Close the session."""
        ...
