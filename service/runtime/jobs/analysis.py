"""Analysis of the archive on demand: harmonics of a window, and the carriers that a rule recommends."""

from dataclasses import dataclass, replace
from typing import NamedTuple

from service.core.estimation.attitude_bound import WheelStatistics
from service.errors import ConflictError, InvalidInputError, NotFoundError
from service.pipeline.calibration.minute_rows import minute_rows
from service.pipeline.calibration.window_harmonics import CarrierHarmonic, paper_harmonics, robust_harmonics
from service.pipeline.config import CalibrationConfig
from service.pipeline.planning.planning import (
    MIN_USABLE,
    Candidates,
    MomentumGain,
    MotionGain,
    Recommendation,
    Rule,
    candidates_of,
    momentum_gain,
    motion_gain,
    recommend,
)
from service.ports.storage import Storage
from service.records.calibration import Calibration, CalibrationMethod, CalibrationResult, CalibrationState, Window
from service.records.catalogue import CarrierPlan, Method, Spacecraft

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


def _wanted_carriers(plan: CarrierPlan, carrier: str | None) -> tuple[str, ...]:
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
