"""Maintenance and analysis of the archive in the background."""

import logging
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

from service.core.estimation.attitude_bound import WheelStatistics
from service.errors import ConflictError, InvalidInputError, NotFoundError
from service.pipeline.calibration.minute_rows import minute_rows
from service.pipeline.calibration.window_harmonics import CarrierHarmonic, paper_harmonics, robust_harmonics
from service.pipeline.config import CalibrationConfig
from service.pipeline.planning.candidates import (
    MIN_USABLE,
    Candidates,
    MomentumGain,
    MotionGain,
    candidates_of,
    momentum_gain,
    motion_gain,
)
from service.pipeline.planning.planning import Recommendation, Rule, recommend
from service.ports.storage import ARCHIVE, Clock, Storage, Term
from service.records.calibration import (
    Alignment,
    Calibration,
    CalibrationMethod,
    CalibrationResult,
    CalibrationState,
    Window,
)
from service.records.catalogue import LIVE_METHODS, CarrierPlan, Method, Spacecraft
from service.records.epoch import US_PER_S, format_epoch
from service.records.storage import (
    LOGS,
    SERIES,
    RetentionConfig,
    RetiredRows,
    SealedPart,
    SealedResults,
    SealingConfig,
)
from service.runtime.live.leadership import always

#: fewest carriers that a choice may be asked for: three angles, a common level and one that checks them
MIN_COUNT = 5
#: carriers chosen when no count is asked for
DEFAULT_COUNT = 16


class WindowHarmonics(NamedTuple):
    """Daily change of a window under the newest ephemeris."""

    plan_id: int
    ephemeris_id: int
    #: measurements in the window
    rows: int
    carriers: tuple[CarrierHarmonic, ...]


@dataclass(frozen=True, slots=True)
class CarrierRecommendation:
    """Recommendation of a rule by a calibration."""

    #: None when carriers were judged by assumptions
    calibration_id: int | None
    calibration_method: str | None
    count: int
    recommendation: Recommendation
    #: limits of the figures' validity
    notes: tuple[str, ...]
    #: None where no momentum is stated
    momentum: MomentumGain | None = None
    #: None where neither a rate sensor nor a polarimeter is stated
    measured_motion: MotionGain | None = None

    def with_motion(self, spacecraft: Spacecraft, wheels: WheelStatistics | None) -> "CarrierRecommendation":
        """Return the recommendation with what wheels and stated sensors would give the chosen carriers."""
        chosen = self.recommendation.sets[self.recommendation.rule.value].chosen
        candidates = self.recommendation.candidates
        return replace(
            self,
            momentum=None if wheels is None else momentum_gain(candidates, chosen, wheels),
            measured_motion=motion_gain(candidates, chosen, spacecraft, wheels),
        )


def window_harmonics(
    storage: Storage, spacecraft_id: str, window: Window, carrier: str | None, method: Method, config: CalibrationConfig
) -> WindowHarmonics:
    """Return the daily change in a window for one carrier of the newest plan or for all.

    Raises
    ------
    NotFoundError
        ``carrier.unknown``; no carrier plan; no ephemeris.
    """
    plan = storage.catalogue.plan(spacecraft_id)
    ephemeris = storage.catalogue.ephemeris(spacecraft_id)
    names = _wanted_carriers(plan, carrier)
    rows = minute_rows(storage.archive.measurement_parts(spacecraft_id, window, names), names, ())
    series = rows.series
    if method is Method.PAPER:
        fits = paper_harmonics(series, ephemeris, window.stop_us, config)
    else:
        longitude_deg = storage.catalogue.spacecraft(spacecraft_id).longitude_deg
        wanted = [one for one in plan.carriers if one.id in names]
        fits = robust_harmonics(series, ephemeris, window.stop_us, wanted, longitude_deg)
    return WindowHarmonics(plan.id, ephemeris.id, int(rows.measurements.sum()), fits)


def recommend_carriers(
    storage: Storage, spacecraft_id: str, count: int | None, rule: Rule, config: CalibrationConfig
) -> CarrierRecommendation:
    """Return the carriers that a rule recommends, by the active calibration by geometry or else the newest one.

    Raises
    ------
    ConflictError
        ``selection.no_calibration``: no calibration has figures yet; ``selection.too_few``: fewer than four of its
        carriers can be used.
    InvalidInputError
        ``selection.count``: more carriers asked for than the calibration has.
    """
    calibration, result = _judging(storage, spacecraft_id)
    plan = storage.catalogue.plan(spacecraft_id)
    candidates = candidates_of(result, plan)
    wanted = wanted_count(candidates, count, f"calibration {calibration.id}")
    recommendation = recommend(candidates, wanted, rule, yaw_scale=config.criteria.yaw_scale)
    return CarrierRecommendation(
        calibration.id, calibration.request.method.value, wanted, recommendation, _notes(calibration, result, plan)
    )


def wanted_count(candidates: Candidates, count: int | None, origin: str) -> int:
    """Return how many carriers to choose: the count asked for, else DEFAULT_COUNT or all when there are fewer.

    Raises
    ------
    InvalidInputError
        ``selection.count``: more than there are.
    ConflictError
        ``selection.too_few``: fewer than four can be used.
    """
    total, usable = len(candidates.carrier_ids), int(candidates.is_usable.sum())
    if count is not None and count > total:
        raise InvalidInputError("selection.count", f"{origin} has {total} carriers")
    if usable < MIN_USABLE:
        detail = (
            f"only {usable} carriers of {origin} can be used, {MIN_USABLE} are needed for three angles and the common "
            "level"
        )
        raise ConflictError("selection.too_few", detail)
    return min(DEFAULT_COUNT, total) if count is None else count


def runnable_methods(alignments: Sequence[Alignment]) -> tuple[Method, ...]:
    """Return the methods that run on every row since the newest alignment: those that it took references for.

    A method whose first calibration came after the alignment runs from then on, but rows before it never get its
    result; what waits for it waits for the other method's result too, for both are stored together.

    Parameters
    ----------
    alignments : sequence
        Of one spacecraft, newest first.
    """
    if not alignments:
        return ()
    named = alignments[0].calibration_by_method
    # alignments of versions that ran one method name none
    return tuple(method for method in LIVE_METHODS if method.value in named) or (Method.PAPER,)


def _wanted_carriers(plan: CarrierPlan, carrier: str | None) -> tuple[str, ...]:
    """Return the carriers to fit."""
    if carrier is None:
        return plan.carrier_ids
    if carrier not in plan.carrier_ids:
        detail = f"no carrier {carrier[:64]!r} in plan {plan.id}; its carriers are {', '.join(plan.carrier_ids)}"
        raise NotFoundError("carrier.unknown", detail)
    return (carrier,)


def _judging(storage: Storage, spacecraft_id: str) -> tuple[Calibration, CalibrationResult]:
    """Return the calibration by which carriers are judged, with its figures."""
    active = storage.results.calibrations(spacecraft_id, CalibrationState.ACTIVE)
    by_geometry = tuple(one for one in active if one.request.method is CalibrationMethod.GEOMETRY)
    for calibration in by_geometry + storage.results.calibrations(spacecraft_id):
        if calibration.result is not None:
            return calibration, calibration.result
    detail = f"no calibration of {spacecraft_id} has figures to choose carriers by"
    raise ConflictError("selection.no_calibration", detail)


def _notes(calibration: Calibration, result: CalibrationResult, plan: CarrierPlan) -> tuple[str, ...]:
    """Return notes on the validity of the figures."""
    notes = []
    known = {carrier.id for carrier in result.carriers}
    fresh = [carrier.id for carrier in plan.carriers if carrier.id not in known and carrier.is_usable_for_attitude]
    if fresh:
        notes.append(f"{', '.join(fresh)} were added by plan {plan.id} after the calibration and are not calibrated")
    if calibration.request.method is CalibrationMethod.PAPER:
        notes.append(
            "coefficients were fitted freely: their errors make yaw look better than it is; a calibration by geometry "
            "is free of that"
        )
    groups = result.geometry.alc_group if result.geometry is not None else ()
    coupled = [carrier.id for carrier, group in zip(result.carriers, groups, strict=False) if group >= 0]
    if coupled:
        notes.append(f"{', '.join(coupled)} are under level control: only differences within a transponder count")
    return tuple(notes)


_LOG = logging.getLogger("soo.maintenance")
_DAY_US = 86_400 * US_PER_S
#: between two looks at the sizes of series, which read them through, s
SIZING_S = 3600.0
_Step = TypeVar("_Step", SealedPart, SealedResults, RetiredRows, int)


class ArchiveMaintenance:
    """Seals days and drops rows while the service runs.

    Parameters
    ----------
    storage : Storage
        The archive.
    clock : Clock
        Tells which days of a spacecraft have ended.
    sealing : SealingConfig
        When days are packed.
    retention : RetentionConfig
        How long series are kept.
    turn : Term, optional
        Tells which spacecraft this process leads: those of others are theirs to maintain.
    """

    def __init__(
        self,
        storage: Storage,
        clock: Clock,
        sealing: SealingConfig,
        retention: RetentionConfig,
        turn: Term = always,
    ) -> None:
        self._turn = turn
        self._storage = storage
        self._clock = clock
        self._sealing = sealing
        self._retention = retention
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        #: measurements and results sealed, and rows dropped of each series, since the start
        self.sealed_rows = self.sealed_results = 0
        #: days of a method that were summarised, since the start
        self.dropped_rows = dict.fromkeys((*SERIES, *LOGS, "replays"), 0)
        #: when the sizes of a spacecraft's series were looked at, s of a clock that only counts
        self._sized_at_s: dict[str, float] = {}
        #: looks at a spacecraft that failed, since the start
        self.failed_polls = 0

    def start(self) -> None:
        """Start the maintenance thread, which runs until stopped."""
        self._thread = threading.Thread(target=self._run, name="soo-maintenance", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Finish the transaction in hand and end the thread."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()

    def poll_once(self) -> None:
        """Do all that is due now of what this process leads; a spacecraft that fails keeps no other one from it."""
        for spacecraft in self._storage.catalogue.all_spacecraft():
            if self._stopping.is_set():
                return
            if not self._turn(spacecraft.id):
                continue
            with self._guarded(spacecraft.id):
                self._drop(spacecraft.id)
                self._drop_replays(spacecraft.id)
                self._drop_logs(spacecraft.id, self._clock.now_us(spacecraft.id))
                self._seal(spacecraft.id)
                self._summarise(spacecraft.id)
        if not self._turn(ARCHIVE):
            return
        with self._guarded("the service"):
            self._drop_logs(None, self._clock.system_us())

    @contextmanager
    def _guarded(self, whose: str) -> Iterator[None]:
        """Outlive every fault; what is due stays due."""
        try:
            yield
        except Exception:  # noqa: BLE001 as the docstring says
            self.failed_polls += 1
            _LOG.exception("archive maintenance of %s failed; it is retried", whose)

    def _run(self) -> None:
        while not self._stopping.wait(self._sealing.period_s):
            try:
                self.poll_once()
            except Exception:  # noqa: BLE001 as above
                _LOG.exception("archive maintenance failed; it is retried")

    def _drop(self, spacecraft_id: str) -> None:
        """Drop what is no longer kept; before days are packed, since what goes need not be."""
        is_sizing = time.monotonic() - self._sized_at_s.get(spacecraft_id, -SIZING_S) >= SIZING_S
        for series in SERIES:
            for before_us in self._bounds(spacecraft_id, series, is_sizing=is_sizing):
                for dropped in self._paced(self._storage.archive.drop_before(spacecraft_id, series, before_us)):
                    self.dropped_rows[series] += dropped.rows
        if is_sizing:
            self._sized_at_s[spacecraft_id] = time.monotonic()

    def _drop_logs(self, spacecraft_id: str | None, now_us: int | None) -> None:
        """Drop old alarms and notes of a spacecraft, or of the service (None)."""
        for name in LOGS:
            if (days := self._retention.days(name)) and now_us is not None:
                log = self._storage.alarms if name == "alarms" else self._storage.notes
                for rows in self._paced(log.drop_before(spacecraft_id, now_us - int(days * _DAY_US))):
                    self.dropped_rows[name] += rows

    def _drop_replays(self, spacecraft_id: str) -> None:
        """Drop old versions, and the rows of those that were deleted."""
        days = self._retention.replays_days
        before_us = self._clock.system_us() - int(days * _DAY_US) if days else None
        for rows in self._paced(self._storage.results.drop_replays(spacecraft_id, before_us)):
            self.dropped_rows["replays"] += rows

    def _bounds(self, spacecraft_id: str, series: str, *, is_sizing: bool) -> Iterator[int]:
        """Yield the epochs before which a series is not kept, by age first."""
        now_us = self._clock.now_us(spacecraft_id)
        if (days := self._retention.days(series)) and now_us is not None:
            yield now_us - int(days * _DAY_US)
        if (size_bytes := self._retention.size_bytes(series)) and is_sizing:
            before_us = self._storage.archive.fitting_us(spacecraft_id, series, size_bytes)
            if before_us is not None:
                yield before_us

    def _seal(self, spacecraft_id: str) -> None:
        """Pack days that have ended and are quiet."""
        now_us, quiet_us = self._clock.now_us(spacecraft_id), int(self._sealing.quiet_s * US_PER_S)
        if now_us is None:
            return
        parts = self._storage.archive.seal(spacecraft_id, now_us - quiet_us, self._clock.system_us() - quiet_us)
        for part in self._paced(parts):
            self._count(spacecraft_id, part)
        for sealed in self._paced(self._storage.results.seal(spacecraft_id, now_us - quiet_us)):
            self.sealed_results += sealed.rows
            _LOG.info(
                "sealed %d %s rows of %s, version %s, from %s",
                sealed.rows,
                sealed.series,
                spacecraft_id,
                sealed.version,
                format_epoch(sealed.first_epoch_us),
            )

    def _summarise(self, spacecraft_id: str) -> None:
        """Summarise closed days, and store up to where every row has its results."""
        now_us, quiet_us = self._clock.now_us(spacecraft_id), int(self._sealing.quiet_s * US_PER_S)
        if now_us is None:
            return
        results = self._storage.results
        for _ in self._paced(results.complete_summaries(spacecraft_id, now_us - quiet_us)):
            pass
        results.mark_complete(spacecraft_id, runnable_methods(results.alignments(spacecraft_id)))

    def _paced(self, steps: Iterable[_Step]) -> Iterator[_Step]:
        """Yield steps with pauses until the thread is to stop."""
        for step in steps:
            yield step
            if self._stopping.wait(self._sealing.pause_s):
                return

    def _count(self, spacecraft_id: str, part: SealedPart) -> None:
        self.sealed_rows += part.rows
        _LOG.info(
            "sealed %d rows of %s, source %s, from %s",
            part.rows,
            spacecraft_id,
            part.source,
            format_epoch(part.first_epoch_us),
        )
