"""Release of one spacecraft in memory: stored state, facts, newest rows, a sign check under way."""

import math
import time
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from service.pipeline.control.release.events import Event, Step
from service.pipeline.control.release.interlock_conditions import RowFacts
from service.pipeline.control.release.row_facts import SeenRow, facts_of_row
from service.records.catalogue import Method, Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import AttitudeRow
from service.runtime.control.persisted_release import Annex, PersistedRelease
from service.runtime.control.release_inputs import KnownFacts
from service.runtime.control.sign_check_run import SignCheckRun

#: rows from whose epochs the row period is taken
_PERIOD_ROWS = 15
_DEFAULT_PERIOD_S = 60.0
#: rows that came late or again say nothing of the present
_NOT_PRESENT = frozenset({"late", "catch_up"})
#: what the estimator makes of a turn that it was not told of; a sign check is told of by the release itself
_OWN_TURN = "unannounced_motion"
#: the estimator tells the statistic itself as a reason
_OUT_OF_BAND = "innovations"
#: what was told of the archive holds for so long, unless something came in, s
_FACTS_S = 20.0


@dataclass(slots=True)
class SpacecraftRelease:
    """One spacecraft on the service."""

    case: PersistedRelease
    #: of the service as the one that leads
    turn: int = 1
    facts: KnownFacts | None = None
    read_s: float = 0.0
    #: newest instant of the spacecraft that was looked at
    newest_us: int = 0
    #: newest row of the method that drives control, with what came beside it
    row: AttitudeRow | None = None
    seen: SeenRow | None = None
    is_disagreeing: bool = False
    epochs_us: deque[int] = field(default_factory=lambda: deque(maxlen=_PERIOD_ROWS + 1))
    run: SignCheckRun | None = None
    #: when the law was asked last under a standing authorisation
    asked_us: int = 0
    #: what was told last: streams are told of changes only
    told: object = None

    @property
    def period_s(self) -> float:
        """Return the expected time to the next row."""
        if len(self.epochs_us) < 2:
            return _DEFAULT_PERIOD_S
        return float(np.median(np.diff(np.array(self.epochs_us)))) / US_PER_S

    @property
    def are_facts_old(self) -> bool:
        """Whether the archive should be asked again."""
        return self.facts is None or time.monotonic() - self.read_s > _FACTS_S

    def take(self, seen: SeenRow, method: Method) -> AttitudeRow | None:
        """Take over a row; return that of the method that drives control, None where it says nothing of the present."""
        row = next((each for each in seen.outcome.rows if each.method is method), None)
        if row is None or _NOT_PRESENT.intersection(row.inhibitions):
            return None
        if self.row is not None and row.epoch_us <= self.row.epoch_us:
            return None
        self.row, self.seen = row, seen
        self.epochs_us.append(row.epoch_us)
        if not math.isnan(seen.outcome.disagreement_deg):
            self.is_disagreeing = seen.outcome.disagreement_deg > 0.0
        return row

    def row_facts(self, row: AttitudeRow) -> RowFacts:
        """Return what the interlock must know of a row."""
        facts = facts_of_row(row, self.period_s, is_innovation_in_band=_OUT_OF_BAND not in row.inhibitions)
        if self.run is None:
            return facts
        return replace(facts, inhibitions=tuple(reason for reason in facts.inhibitions if reason != _OWN_TURN))


class Stepper(Protocol):
    """Judges and stores an event of a spacecraft."""

    def __call__(
        self, release: SpacecraftRelease, spacecraft: Spacecraft, event: Event, annex: Annex | None = None
    ) -> Step:
        """Return what the event has led to."""
        ...
