"""Checks of alarms by the clock: missing rows, links, ages of the inputs of the estimate, keys, disk.

Everything is asked of the archive; links are judged by the system's time, the rest by the spacecraft's clock.
"""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

from service.errors import NotFoundError
from service.pipeline.alarms.alarm_engine import Explanation, Readings
from service.pipeline.alarms.readings import RowReader
from service.pipeline.control.release.command_states import UNREPORTED, State
from service.pipeline.control.release.events import ReleaseState, state_of
from service.ports.storage import Clock, Storage
from service.records.calibration import CalibrationState
from service.records.epoch import US_PER_S
from service.records.levels.measurement import HeadState, SourceState
from service.records.operations.work import LinkState
from service.runtime.live.supervisor import StepFailures

_SILENT = "SILENT"
#: the least age of a warning, so that one of this very instant stands too, s
_LEAST_AGE_S = 1e-3
_HOUR_US = 3600 * US_PER_S
_DAY_US = 24 * _HOUR_US
#: a key that ended so long ago needs no alarm: who used it has noticed
_ENDED_DAYS = 1.0
_MB = 1e6


class StoredFacts(NamedTuple):
    """Facts of every spacecraft in the archive: statements for each of hundreds cost more than their rows."""

    heads: dict[str, HeadState]
    links: tuple[LinkState, ...]
    sources: dict[str, list[SourceState]]
    #: records of telemetry that were refused one after another
    refused: dict[str, int]
    release_versions: dict[str, int]

    @classmethod
    def read(cls, storage: Storage) -> "StoredFacts":
        """Return what a storage holds now."""
        archive, refused = storage.archive, storage.alarms.refused()
        return cls(archive.heads(), storage.links.links(), archive.every_source(), refused, storage.releases.versions())


@dataclass(slots=True)
class _Seen:
    """Memory of the checks of one spacecraft; a restart may forget it."""

    #: start of the checks, by the spacecraft's clock
    started_us: int
    #: missing rows of each source over the last hour
    missing: dict[str, deque[tuple[int, int]]] = field(default_factory=dict)
    #: since when documents have differed from their digests
    damaged_us: dict[str, int] = field(default_factory=dict)


class ClockChecks:
    """Checks of one spacecraft and of the service that depend on the clock.

    Parameters
    ----------
    storage : Storage
        What is asked.
    clock : Clock
        The only source of time.
    stale_periods : float
        Periods without a row that are waited for after a start before rows are missed.
    failures : StepFailures
        Of the estimator.
    """

    def __init__(self, storage: Storage, clock: Clock, stale_periods: float, failures: StepFailures) -> None:
        self._failures = failures
        self._storage = storage
        self._clock = clock
        self._grace_periods = stale_periods
        self._seen: dict[str, _Seen] = {}
        #: newest state of each release by its version
        self._releases: dict[str, tuple[int, ReleaseState]] = {}
        self._down_since_us: dict[str, int] = {}

    def of_inputs(self, spacecraft_id: str, reader: RowReader, now_us: int, stored: StoredFacts) -> Iterator[Readings]:
        """Yield the readings of the inputs: age of the newest row, missing rows, links and their warnings."""
        seen = self._seen.setdefault(spacecraft_id, _Seen(now_us))
        sources, links = stored.sources.get(spacecraft_id, []), _links_of(spacecraft_id, stored.links)
        # a link that is down explains what no longer comes through it, and goes first
        yield from self._links(links)
        link_of = {link.report.source: Explanation(("link_down", link.report.id)) for link in links}
        yield from self._age(sources, reader, seen, now_us, link_of)
        yield Readings("rows_missing", *_missing(sources, seen, now_us))

    def of_estimator(self, spacecraft_id: str) -> Readings:
        """Return for how long the estimator has failed; nothing is read from the archive."""
        failing = self._failures.lasting(spacecraft_id)
        now_us = self._clock.system_us()
        lasting_s = tuple(max((now_us - each.since_us) / US_PER_S, _LEAST_AGE_S) for each in failing)
        things = tuple(each.kind for each in failing)
        return Readings("estimator_failed", things, lasting_s, {each.kind: each.error for each in failing})

    def of_telemetry(self, spacecraft_id: str, stored: StoredFacts) -> Readings:
        """Return how many records of momenta were refused one after another."""
        return Readings("telemetry_refused", ("momentum",), (float(stored.refused.get(spacecraft_id, 0)),))

    def of_release(self, spacecraft_id: str, now_us: int, version: int) -> Iterator[Readings]:
        """Yield the readings of the stored release of torques, whose newest version is known."""
        state = self._release_state(spacecraft_id, version)
        since_s = max((now_us - state.interlock.since_us) / US_PER_S, _LEAST_AGE_S)
        trips = tuple(condition.word for condition in state.interlock.trips)
        yield Readings("control_tripped", trips, (since_s,) * len(trips))
        balanced = ("torque",) if state.interlock.state is State.BALANCE else ()
        yield Readings("control_balance", balanced, (since_s,) * len(balanced))
        waiting = [command for command in state.commands if command.state in UNREPORTED]
        over_s = [(now_us - max(each.stop_us, each.released_us or 0)) / US_PER_S for each in waiting]
        yield Readings("report_late", tuple(f"command {each.counter}" for each in waiting), tuple(over_s))

    def _release_state(self, spacecraft_id: str, version: int) -> ReleaseState:
        """Return the stored state of a release; one that has not changed is not read again."""
        known, state = self._releases.get(spacecraft_id, (-1, None))
        if state is None or version != known:
            releases = self._storage.releases
            stored = releases.stored(spacecraft_id)
            state = state_of(stored.document, partial(releases.command, spacecraft_id))
            self._releases[spacecraft_id] = stored.version, state
        return state

    def of_foundations(self, spacecraft_id: str, now_us: int) -> Iterator[Readings]:
        """Yield the readings of the documents in force: damage, ages of calibrations, end of the ephemeris."""
        damaged = self._storage.catalogue.damaged_documents(spacecraft_id)
        seen = self._seen.setdefault(spacecraft_id, _Seen(now_us))
        seen.damaged_us = {name: seen.damaged_us.get(name, now_us) for name in damaged}
        lasting_s = tuple(max((now_us - since_us) / US_PER_S, _LEAST_AGE_S) for since_us in seen.damaged_us.values())
        yield Readings("document_corrupt", tuple(seen.damaged_us), lasting_s)
        active = self._storage.results.calibrations(spacecraft_id, CalibrationState.ACTIVE)
        ages = {f"{one.request.method} {one.id}": now_us - one.request.data_until_us for one in active}
        yield Readings("calibration_old", tuple(ages), tuple(age_us / _DAY_US for age_us in ages.values()))
        try:
            ephemeris = self._storage.catalogue.ephemeris(spacecraft_id)
        except NotFoundError:
            return
        yield Readings("ephemeris_ending", ("newest",), ((ephemeris.valid_stop_us - now_us) / _HOUR_US,))

    def of_service(self, now_us: int) -> Iterator[Readings]:
        """Yield the readings of disk and keys."""
        free_bytes = self._storage.state().free_bytes
        if free_bytes is not None:
            yield Readings("disk_full", ("archive",), (free_bytes / _MB,))
        left_days = {}
        for stored in self._storage.keys.all():
            key = stored.key
            if key.revoked_at_us is None and key.expires_at_us is not None:
                left_days[f"{key.name} ({key.id})"] = (key.expires_at_us - now_us) / _DAY_US
        kept = {name: days for name, days in left_days.items() if days > -_ENDED_DAYS}
        yield Readings("key_ending", tuple(kept), tuple(kept.values()))

    def _age(
        self,
        sources: Sequence[SourceState],
        reader: RowReader,
        seen: _Seen,
        now_us: int,
        link_of: Mapping[str | None, Explanation],
    ) -> Iterator[Readings]:
        """Yield the age of the prime source's newest row in row periods, once rows have come in time."""
        prime = next((source for source in sources if source.role == "prime"), None)
        period_s = reader.row_period_s
        if prime is None or prime.newest_epoch_us is None or reader.newest_row_us is None or not period_s:
            return
        age = (now_us - prime.newest_epoch_us) / US_PER_S / period_s
        waited = (now_us - seen.started_us) / US_PER_S / period_s
        link = link_of.get(prime.id)
        # a service that was away itself must not blame the source before it had time to send
        is_known = waited >= self._grace_periods or age < self._grace_periods
        note = f"the newest row is {age * period_s:.0f} s old, rows come every {period_s:g} s"
        aged, causes = (age if is_known else float("nan"),), {} if link is None else {prime.id: link}
        yield Readings("data_stale", (prime.id,), aged, {prime.id: note}, causes=causes)

    def _links(self, links: list[LinkState]) -> Iterator[Readings]:
        """Yield how long links have not worked, and what they warn of; a front end explains what it holds."""
        now_us = self._clock.system_us()
        down_s, down_notes, warning_s, notes = {}, {}, {}, {}
        holder_of = {name: link.report.id for link in links for name in _held(link)}
        causes = {name: Explanation(("link_down", holder)) for name, holder in holder_of.items()}
        warned = {}
        for link in links:
            down_s[link.report.id] = self._down_s(link, now_us)
            down_notes[link.report.id] = f"its state is {_SILENT if link.is_silent(now_us) else link.report.state}"
            for warning in link.report.warnings:
                thing = f"{link.report.id}/{warning.code}"
                since_us = link.reported_at_us if warning.since_us is None else warning.since_us
                warning_s[thing] = max((now_us - since_us) / US_PER_S, _LEAST_AGE_S)
                notes[thing] = warning.detail
                warned[thing] = Explanation(("link_down", link.report.id))
        yield Readings("link_down", tuple(down_s), tuple(down_s.values()), down_notes, causes=causes)
        yield Readings("link_warning", tuple(warning_s), tuple(warning_s.values()), notes, causes=warned)

    def _down_s(self, link: LinkState, now_us: int) -> float:
        """Return for how long a link that should work has not, 0 while it does."""
        name = link.report.id
        if not link.is_down(now_us):
            self._down_since_us.pop(name, None)
            return 0.0
        since_us = self._down_since_us.setdefault(name, link.reported_at_us)
        return max((now_us - since_us) / US_PER_S, _LEAST_AGE_S)


def _links_of(spacecraft_id: str, links: tuple[LinkState, ...]) -> list[LinkState]:
    """Return the front ends that hold the links of a spacecraft, and then these."""
    own = [link for link in links if link.report.spacecraft_id == spacecraft_id]
    names = {link.report.id for link in own}
    return [link for link in links if link.report.spacecraft_id is None and names.intersection(_held(link))] + own


def _held(link: LinkState) -> list[str]:
    """Return the links that a front end holds."""
    held = link.report.detail.get("analyzers")
    return list(map(str, held)) if isinstance(held, list) else []


def _missing(sources: Sequence[SourceState], seen: _Seen, now_us: int) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """Return by how much the missing rows of each source grew within the last hour."""
    grown = {}
    for source in sources:
        if source.rows_missing is None:
            continue
        history = seen.missing.setdefault(source.id, deque())
        while history and history[0][0] < now_us - _HOUR_US:
            history.popleft()
        # of many looks without a change only the newest is kept
        if len(history) > 1 and history[-1][1] == history[-2][1] == source.rows_missing:
            history.pop()
        history.append((now_us, source.rows_missing))
        grown[source.id] = float(source.rows_missing - min(count for _, count in history))
    return tuple(grown), tuple(grown.values())
