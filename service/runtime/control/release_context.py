"""Context of the release of one spacecraft: facts of the archive, newest rows, rows of a running sign check."""

import math
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from service.errors import ConflictError
from service.pipeline.config import TorqueConfig
from service.pipeline.control.release.events import ReleaseState, StoredRow
from service.pipeline.control.release.interlock_conditions import InterlockRow, interlock_row
from service.pipeline.control.release.settings import ReleaseSettings
from service.pipeline.control.release.sign_checks import is_running
from service.ports import Storage
from service.records.catalogue import Method, Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import AttitudeRow
from service.runtime.control.release_inputs import KnownFacts
from service.runtime.control.sign_check_rows import SignCheckRows
from service.runtime.control.spacecraft_release import SpacecraftRelease

#: rows from whose epochs the row period is taken
_PERIOD_ROWS = 15
_DEFAULT_PERIOD_S = 60.0
#: rows that came late or again say nothing of the present
_NOT_PRESENT = frozenset({"late", "catch_up"})
#: the estimator's reason for a turn that was not announced; a sign check announces none
_OWN_TURN = "unannounced_motion"
#: the estimator's reason for its statistic
_OUT_OF_BAND = "innovations"


@dataclass(slots=True)
class ReleaseContext:
    """Release of one spacecraft with all that its events are built from."""

    release: SpacecraftRelease
    storage: Storage
    settings: ReleaseSettings
    #: of the control law
    torque: TorqueConfig
    #: of the service as the one that leads
    turn: int = 1
    known: KnownFacts | None = None
    read_s: float = 0.0
    #: newest instant of the spacecraft that was looked at
    newest_us: int = 0
    #: newest row of the method that drives control, with what came with it
    newest_row: AttitudeRow | None = None
    stored: StoredRow | None = None
    is_disagreeing: bool = False
    epochs_us: deque[int] = field(default_factory=lambda: deque(maxlen=_PERIOD_ROWS + 1))
    sign_rows: SignCheckRows | None = None
    #: when the law was asked last under a standing authorisation
    asked_us: int = 0

    @property
    def state(self) -> ReleaseState:
        """State after the newest event."""
        return self.release.state

    @property
    def facts(self) -> KnownFacts:
        """Facts of the archive as they were read last."""
        if self.known is None:
            message = "the facts of the archive have not been read"
            raise ValueError(message)
        return self.known

    @property
    def spacecraft(self) -> Spacecraft:
        """Spacecraft as the catalogue states it."""
        return self.facts.spacecraft

    @property
    def row(self) -> AttitudeRow:
        """Newest row of the method that drives control; ConflictError ``command.no_estimate`` before the first."""
        if self.newest_row is None:
            raise ConflictError("command.no_estimate", "there is no row of the method that drives control yet")
        return self.newest_row

    @property
    def period_s(self) -> float:
        """Expected time to the next row."""
        if len(self.epochs_us) < 2:
            return _DEFAULT_PERIOD_S
        return float(np.median(np.diff(np.array(self.epochs_us)))) / US_PER_S

    @property
    def stale_us(self) -> int:
        """Age at which an estimate is too old."""
        return self.settings.stale_us(self.period_s)

    def update(self, stored: StoredRow, method: Method) -> AttitudeRow | None:
        """Update with a row; return that of the method that drives control, None where it is not of the present."""
        row = next((each for each in stored.outcome.rows if each.method is method), None)
        if row is None or _NOT_PRESENT.intersection(row.inhibitions):
            return None
        if self.newest_row is not None and row.epoch_us <= self.newest_row.epoch_us:
            return None
        self.newest_row, self.stored = row, stored
        self.epochs_us.append(row.epoch_us)
        if not math.isnan(stored.outcome.disagreement_deg):
            self.is_disagreeing = stored.outcome.disagreement_deg > 0.0
        return row

    def row_facts(self, row: AttitudeRow) -> InterlockRow:
        """Return the facts of a row for the interlock."""
        facts = interlock_row(row, self.period_s, is_innovation_in_band=_OUT_OF_BAND not in row.inhibitions)
        if not is_running(self.state.sign_check):
            return facts
        return replace(facts, inhibitions=tuple(reason for reason in facts.inhibitions if reason != _OWN_TURN))
