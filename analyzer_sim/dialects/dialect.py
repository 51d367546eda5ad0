"""Dialect of one maker's analyzer, as data: its commands, start-up settings and peculiarities."""

from dataclasses import dataclass, replace

from analyzer_sim.dialects.rows.command_row import Command
from analyzer_sim.dialects.rows.trace_rows import TraceStyle
from analyzer_sim.instrument.imperfections import Imperfections
from analyzer_sim.instrument.settings.analyzer_model import AnalyzerModel


@dataclass(frozen=True, slots=True)
class Dialect:
    """One maker's language.

    A new dialect is a module with a table of rows and one ``Dialect``, entered in ``dialects.py``.
    """

    #: name on the command line
    name: str
    #: answer to ``*IDN?``
    identity: str
    #: figures and state after a reset
    model: AnalyzerModel
    #: how traces are written
    traces: TraceStyle
    #: units of levels
    units: tuple[str, ...]
    #: rows of this dialect beside the common commands
    commands: tuple[Command, ...]
    #: messages that the raw socket takes for the interface and the parser never sees
    interface_messages: frozenset[bytes] = frozenset()
    #: relative headers that miss their path are looked up from the root
    is_lenient: bool = False
    #: noise the analyzer adds at 0 dB attenuation, preamplifier off, dBm/Hz
    own_noise_dbm_hz: float = -150.0

    #: where it differs from the real instruments on purpose, a sentence each
    deviations: tuple[str, ...] = ()

    @property
    def imperfections(self) -> Imperfections:
        """The default figures of this make's errors."""
        return replace(Imperfections(), own_noise_dbm_hz=self.own_noise_dbm_hz)
