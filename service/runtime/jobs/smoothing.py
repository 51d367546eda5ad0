"""Smoothed rows: made with a lag behind the journal by jobs."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from service.pipeline.chain import Chain
from service.pipeline.checkpoints import fingerprint
from service.pipeline.config import ChainConfig
from service.pipeline.estimation.smoothed import GRID_US, LaggedRows, grid_us
from service.ports.archive import SMOOTHED, Outcome
from service.ports.storage import Storage, Term
from service.records.catalogue import Method
from service.records.epoch import US_PER_S, format_epoch
from service.records.levels.attitude import AttitudeRow
from service.records.levels.measurement import Measurement
from service.records.operations.work import Job
from service.records.setting import CHOSEN, setting
from service.runtime.live.journal_consumer import (
    DocumentCache,
    consume,
    numbered_alignments,
    restored_checkpoint,
    update_before,
)
from service.runtime.live.leadership import always

_ENTRIES_AT_ONCE = 512
#: instants that one run passes, us: at a row a second their rows take three minutes
_PART_US = 6 * 3600 * US_PER_S
#: a run may begin so long before the first row that it makes, us; the last checkpoint of each day is kept
_REACH_US = 2 * 86_400 * US_PER_S


class LaggedPart(NamedTuple):
    """Smoothed rows that a run has made."""

    rows: tuple[AttitudeRow, ...]
    #: instant of the grid up to which they are made now, microseconds UTC
    made_us: int
    #: whether the instants up to there have no rows because no state of the chain is kept that is old enough
    is_skipped: bool


class LaggedRun:
    """Run of one part.

    Parameters
    ----------
    storage : Storage
        Journal and checkpoints.
    config : ChainConfig
        Configuration of the chain.
    spacecraft_id : str
        Spacecraft.
    lag_us : int
        A row is made when the data reach so far beyond it.
    after_us : int
        Instant of the grid up to which rows are made already, microseconds UTC.
    until_number : int
        Journal number of the last entry that the live chain has consumed.
    """

    def __init__(
        self, storage: Storage, config: ChainConfig, spacecraft_id: str, lag_us: int, after_us: int, until_number: int
    ) -> None:
        self._storage, self._config, self._id = storage, config, spacecraft_id
        self._after_us, self._until = after_us, until_number
        self._lagged = LaggedRows(lag_us, after_us)
        documents = DocumentCache(storage.catalogue, storage.results, spacecraft_id)
        # torques are nobody's here: those that counted as applied stand in the journal
        self._chain = Chain(
            documents, config, methods=(Method.ROBUST,), has_commands=False, recorder=self._lagged.recorder
        )

    def steps(self) -> Iterator[LaggedPart | None]:
        """Make the rows of the next six hours at most, and yield them at the end; None with each row before."""
        after_us, position = self._after_us, self._begun()
        if position is None:
            first_us = self._first_us()
            made_us = after_us if first_us is None else grid_us(first_us + GRID_US - 1)
            yield LaggedPart((), made_us, made_us > after_us)
            return
        rows: list[AttitudeRow] = []
        for made in self._made(position):
            rows += made
            yield None
            if self._lagged.made_us >= after_us + _PART_US:
                break
        yield LaggedPart(tuple(rows), self._lagged.made_us, is_skipped=False)

    def _made(self, position: int) -> Iterator[list[AttitudeRow]]:
        """Yield the smoothed rows that are due with each row of the journal behind a number."""
        archive = self._storage.archive
        while entries := archive.journal(self._id, position, _ENTRIES_AT_ONCE):
            for entry in entries:
                if entry.number > self._until:
                    return
                for outcome in consume(self._chain, entry, archive, self._id):
                    yield self._lagged.push(outcome.rows[0].epoch_us, outcome.rows)
                content = entry.content
                # also where no method runs: an instant without rows is passed
                if isinstance(content, Measurement) and content.feeds_estimator:
                    yield self._lagged.push(content.epoch_us, ())
            position = entries[-1].number

    def _begun(self) -> int | None:
        """Bring the chain to a state before the first row wanted and return its journal number; None = there is none.

        A checkpoint comes first: an alignment that came after rows gives other states than they had.
        """
        after_us = self._after_us
        kept = restored_checkpoint(self._storage, self._id, self._chain, self._config, 0, self._until, after_us + 1)
        if kept is not None:
            return kept.number if kept.epoch_us >= after_us - _REACH_US else None
        standing = [each for each in self._alignments() if after_us - _REACH_US <= each[1] <= after_us]
        if not standing:
            return None
        number, epoch_us = max(standing)
        update_before(self._chain, self._storage.archive, self._id, number, epoch_us)
        return number - 1

    def _first_us(self) -> int | None:
        """Return the earliest epoch after the wanted instant at which a run can begin, microseconds UTC."""
        kept = self._storage.results.checkpoints(self._id, fingerprint(self._config), self._until)
        epochs_us = [*(each.epoch_us for each in kept), *(epoch_us for _, epoch_us in self._alignments())]
        return min((epoch_us for epoch_us in epochs_us if epoch_us > self._after_us), default=None)

    def _alignments(self) -> list[tuple[int, int]]:
        """Return journal number and epoch of every alignment that the live chain has consumed."""
        return [each for each in numbered_alignments(self._storage.results, self._id) if each[0] <= self._until]


_LOG = logging.getLogger("soo.lagged")
#: instants that lie further back than this are not made: of data, us
_MOST_BEHIND_US = 7 * 86_400 * US_PER_S
_LONGEST_LAG_S = 43_200.0


@dataclass(frozen=True, slots=True)
class SmoothingConfig:
    """Live series of smoothed angles."""

    lag_s: float = setting(
        7200.0, "a smoothed angle is made when the data reach so far beyond it, s; 0 = no such series", CHOSEN
    )

    def __post_init__(self) -> None:
        """Refuse a lag that says nothing, or that takes in more than later rows can say."""
        if self.lag_s != 0 and not GRID_US / US_PER_S <= self.lag_s <= _LONGEST_LAG_S:
            raise ValueError("lag_s is 0, or from 300 to 43200 s")


class SmoothingDue:
    """Knows of which spacecraft smoothed rows are due.

    Parameters
    ----------
    storage : Storage
        The archive.
    config : SmoothingConfig
        The lag; 0 = nothing is ever due.
    turn : Term, optional
        Tells which spacecraft this process leads.
    """

    def __init__(self, storage: Storage, config: SmoothingConfig, turn: Term = always) -> None:
        self._storage, self._turn, self._lag_us = storage, turn, round(config.lag_s * US_PER_S)
        #: term of leading, and instant of the grid up to which rows were ordered
        self._ordered: dict[str, tuple[int, int]] = {}

    def due(self) -> Iterator[str]:
        """Yield the spacecraft of which rows have come due since they were yielded last."""
        if not self._lag_us:
            return
        for spacecraft_id, head in self._storage.archive.heads().items():
            turn = self._turn(spacecraft_id)
            if turn and head.consumed_epoch_us is not None:
                due = turn, grid_us(head.consumed_epoch_us - self._lag_us)
                if due != self._ordered.get(spacecraft_id):
                    self._ordered[spacecraft_id] = due
                    yield spacecraft_id

    def failed(self, spacecraft_id: str) -> None:
        """Order again what was not made."""
        self._ordered.pop(spacecraft_id, None)


class SmoothingWork:
    """Work of the jobs that make the smoothed rows which are due.

    Parameters
    ----------
    storage : Storage
        The archive.
    chain_config : ChainConfig
        Configuration of the chain.
    config : SmoothingConfig
        The lag.
    """

    def __init__(self, storage: Storage, chain_config: ChainConfig, config: SmoothingConfig) -> None:
        self._storage, self._chain_config, self._lag_us = storage, chain_config, round(config.lag_s * US_PER_S)
        #: instant of the grid up to which rows are made, where there are none at it
        self._made_us: dict[str, int] = {}

    def __call__(self, job: Job) -> Iterator[float]:
        """Make and store rows part by part until none are due."""
        spacecraft_id = job.spacecraft_id or ""
        head = self._storage.archive.head(spacecraft_id)
        if head.consumed_epoch_us is None or not self._is_robust(spacecraft_id):
            return
        due_us = grid_us(head.consumed_epoch_us - self._lag_us)
        first_us = after_us = self._after_us(spacecraft_id, due_us)
        while after_us < due_us:
            order = self._lag_us, after_us, head.consumed_number
            progress = (after_us - first_us) / (due_us - first_us)
            for part in LaggedRun(self._storage, self._chain_config, spacecraft_id, *order).steps():
                if part is not None:
                    self._store(spacecraft_id, after_us, part)
                    # without a state to begin with, as before the first alignment, there is nothing to wait for
                    after_us = part.made_us if part.made_us > after_us else due_us
                yield progress
            self._made_us[spacecraft_id] = after_us

    def _store(self, spacecraft_id: str, after_us: int, part: LaggedPart) -> None:
        """Store the rows behind an instant, or say why there are none."""
        if part.is_skipped:
            _report_gap(spacecraft_id, after_us, part.made_us, "no state of the chain is kept that is old enough")
        if part.rows:
            outcomes = [Outcome((row,), None) for row in part.rows]
            self._storage.results.save_outcomes(spacecraft_id, SMOOTHED, outcomes, 0, None)

    def _is_robust(self, spacecraft_id: str) -> bool:
        """Return whether the robust method was ever aligned; without it there is nothing to smooth."""
        alignments = self._storage.results.alignments(spacecraft_id)
        return any(Method.ROBUST.value in each.calibration_by_method for each in alignments)

    def _after_us(self, spacecraft_id: str, due_us: int) -> int:
        """Return the instant up to which nothing is to be made."""
        newest = self._storage.results.newest_attitude(spacecraft_id, SMOOTHED, Method.ROBUST_SMOOTHED)
        first_us = due_us - _MOST_BEHIND_US
        stored_us = first_us if newest is None else grid_us(newest.epoch_us + GRID_US - 1)
        made_us = max(stored_us, self._made_us.get(spacecraft_id, stored_us))
        if made_us < first_us:
            _report_gap(spacecraft_id, made_us, first_us, "they lie too far back")
        return max(made_us, first_us)


def _report_gap(spacecraft_id: str, start_us: int, stop_us: int, reason: str) -> None:
    _LOG.info(
        "no smoothed rows of %s are made from %s to %s: %s. A replay with smooth=true makes them.",
        spacecraft_id,
        format_epoch(start_us),
        format_epoch(stop_us),
        reason,
    )
