"""Beams of the antennas by the archive: kept summaries of deviations, readings of a working sensor, calibrations.

Nothing is stored. Of a long span whole days are read at equal distances, at most ``MAX_DAYS``, so that a year costs
what two months do.
"""

from dataclasses import dataclass

import numpy as np

from service.core.rows import SampleBins
from service.errors import ConflictError, InvalidInputError
from service.pipeline.carrier_model.beam_report import HOUR_US, BeamReport, Group, HourlyMeans, beam_report
from service.ports.archive import LIVE
from service.ports.storage import Storage
from service.records.calibration import Calibration, CalibrationMethod, CalibrationState, Window
from service.records.catalogue import Method
from service.records.epoch import LATEST_EPOCH_US
from service.records.levels.attitude import FloatArray

#: most days that are read for one answer, and longest span
MAX_DAYS, MAX_SPAN_DAYS = 62, 800
_DAY_US = 24 * HOUR_US
#: least stretch of an hour that a sensor's readings must span to tell its mean
_MIN_SPREAD_US = HOUR_US // 4


@dataclass(frozen=True, slots=True)
class BeamAnalysis:
    """Report of a span, with what it was made from."""

    window: Window
    calibration_id: int
    #: None = no calibration by geometry before it
    compared_calibration_id: int | None
    sensors: tuple[str, str, str]
    #: days between those that were read, 1 = all
    day_step: int
    report: BeamReport
    #: limits of the figures' validity
    notes: tuple[str, ...]


def analyse_beams(storage: Storage, spacecraft_id: str, window: Window, group: Group) -> BeamAnalysis:
    """Return boresights and beams by the active calibration by geometry.

    Raises
    ------
    ConflictError
        ``beams.no_calibration``: no calibration by geometry is active.
    InvalidInputError
        ``range.too_long``: the span is longer than can be judged.
    """
    if window.stop_us - window.start_us > MAX_SPAN_DAYS * _DAY_US:
        detail = f"the span is longer than {MAX_SPAN_DAYS} days"
        raise InvalidInputError("range.too_long", detail)
    now, before = _campaigns(storage, spacecraft_id)
    result = now.result
    if result is None or result.geometry is None:
        raise _no_calibration(spacecraft_id)
    since_us = _since(storage, spacecraft_id, now)
    begin_us = max(window.start_us, since_us)
    names = tuple(carrier.id for carrier in result.carriers)
    sensors = (now.request.source_yaw, now.request.source_roll, now.request.source_pitch)
    first, behind = begin_us // _DAY_US, -(-window.stop_us // _DAY_US)
    step = max(1, -(-(behind - first) // MAX_DAYS))
    days = [_of_day(storage, spacecraft_id, day, window, names, sensors) for day in range(first, behind, step)]
    hours = _joined(days, len(names))
    report = beam_report(result, result.geometry, now.request.quiet, before.result if before else None, hours, group)
    notes = _notes(window, since_us, step, report, sensors)
    return BeamAnalysis(window, now.id, before.id if before else None, sensors, step, report, notes)


def _no_calibration(spacecraft_id: str) -> ConflictError:
    detail = f"no calibration by geometry of {spacecraft_id} is active"
    return ConflictError("beams.no_calibration", detail)


def _campaigns(storage: Storage, spacecraft_id: str) -> tuple[Calibration, Calibration | None]:
    """Return the active calibration by geometry, and the newest one before it that was made from other turns."""
    made = [
        one
        for one in storage.results.calibrations(spacecraft_id)
        if one.request.method is CalibrationMethod.GEOMETRY and one.result is not None
    ]
    active = next((one for one in made if one.state is CalibrationState.ACTIVE), None)
    if active is None:
        raise _no_calibration(spacecraft_id)
    turns = active.request.turns
    earlier = [one for one in made if one.request.turns.stop_us <= turns.start_us]
    return active, max(earlier, key=lambda one: one.request.turns.stop_us, default=None)


def _since(storage: Storage, spacecraft_id: str, calibration: Calibration) -> int:
    """Return from when on deviations were computed with a calibration, behind every epoch where none were."""
    alignments = storage.results.alignments(spacecraft_id)
    used = [
        one.epoch_us
        for one in alignments
        if one.calibration_by_method.get(Method.ROBUST.value, one.calibration_id) == calibration.id
    ]
    return min(used, default=LATEST_EPOCH_US)


def _of_day(
    storage: Storage, spacecraft_id: str, day: int, window: Window, names: tuple[str, ...], sensors: tuple[str, ...]
) -> HourlyMeans:
    """Return the hours of a day that the window holds whole or in part."""
    inside = Window(max(window.start_us, day * _DAY_US), min(window.stop_us, (day + 1) * _DAY_US))
    bins = SampleBins(day * _DAY_US, (day + 1) * _DAY_US, 24, len(names))
    of = (spacecraft_id, LIVE, Method.ROBUST, inside, bins)
    for plan_id, buckets in storage.results.sampled_carriers(*of):
        held = storage.catalogue.plan(spacecraft_id, plan_id).carrier_ids
        common = [(position, names.index(name)) for position, name in enumerate(held) if name in names]
        at, columns = np.array(common, dtype=np.int64).reshape(-1, 2).T
        bins.add_summaries(buckets.columns(at), columns)
    found = bins.all_intervals()
    with np.errstate(invalid="ignore", divide="ignore"):
        deviation_db = np.where(found.counts > 0, found.sums / np.maximum(found.counts, 1), np.nan)
    attitude_deg, range_deg = _sensor_hours(storage, spacecraft_id, inside, sensors, day * _DAY_US)
    return HourlyMeans(found.first_us, deviation_db, found.counts, attitude_deg, range_deg)


def _sensor_hours(
    storage: Storage, spacecraft_id: str, window: Window, sensors: tuple[str, ...], day_us: int
) -> tuple[FloatArray, FloatArray]:
    """Return mean angles (24, 3) of the hours of a day, and the range of roll or pitch (24,); NaN = not told."""
    mean, reach = np.full((24, 3), np.nan), np.full((24, 3), np.nan)
    for series in storage.archive.reference_series(spacecraft_id, window):
        hour = (series.epochs_us - day_us) // HOUR_US
        for axis in (k for k, sensor in enumerate(sensors) if sensor == series.source):
            is_seen = np.isfinite(series.attitude_deg[:, axis])
            for k in np.unique(hour[is_seen]):
                those = is_seen & (hour == k)
                if np.ptp(series.epochs_us[those]) >= _MIN_SPREAD_US:
                    mean[k, axis] = series.attitude_deg[those, axis].mean()
                    reach[k, axis] = np.ptp(series.attitude_deg[those, axis])
    return mean, reach[:, 1:].max(axis=1)


def _joined(days: list[HourlyMeans], carriers: int) -> HourlyMeans:
    """Return the hours of some days in which both powers and sensor tell something."""
    if not days:
        none = np.zeros((0, carriers))
        return HourlyMeans(np.zeros(0, np.int64), none, none.astype(np.int64), np.zeros((0, 3)), np.zeros(0))
    start_us, deviation_db, rows, attitude_deg, range_deg = (
        np.concatenate([getattr(day, name) for day in days]) for name in HourlyMeans._fields
    )
    known = np.isfinite(attitude_deg).all(axis=1) & np.isfinite(deviation_db).any(axis=1)
    return HourlyMeans(start_us[known], deviation_db[known], rows[known], attitude_deg[known], range_deg[known])


def _notes(window: Window, since_us: int, step: int, report: BeamReport, sensors: tuple[str, ...]) -> tuple[str, ...]:
    """Return notes on the validity of the figures."""
    if since_us >= window.stop_us:
        return ("no alignment before the end of the span uses this calibration: no boresight",)
    notes = []
    if since_us > window.start_us:
        notes.append("the series begins with the first alignment by this calibration; before it others were in force")
    if step > 1:
        notes.append(f"of the span every {step}th day was read")
    if not len(report.hours.start_us):
        notes.append(f"no hour has both powers and readings of {', '.join(dict.fromkeys(sensors))}: no boresight")
    elif not report.antennas:
        notes.append("no antenna has five carriers that show the pattern of their uplink beam: no boresight")
    elif len(report.antennas) == 1:
        notes.append("with one antenna a boresight cannot be told from an error of the sensor")
    return tuple(notes)
