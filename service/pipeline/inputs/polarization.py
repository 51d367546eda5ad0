"""Polarimeters by the catalogue, and their records of the last minutes as blocks for the filter.

The filter takes the median angle of some minutes: a single wild record changes nothing, and a moved feed stands out of
the noise. A block whose ratios are all the same to the last digit measured nothing.
"""

import math
import statistics
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from functools import lru_cache, partial

import numpy as np

from service.core.estimation.filtering.filter_model import LearnedFeed, PolarimeterModel
from service.core.estimation.filtering.plant import DAY_US
from service.core.estimation.filtering.polarimeter import (
    AngleBlock,
    angle_deg,
    faraday_deg,
    slope_db_deg,
    turned_deg,
)
from service.core.geometry.frames import station_direction
from service.core.geometry.line_of_sight import PredictedTrack, frame_turn_deg
from service.records.calibration import Calibration, FeedFit
from service.records.catalogue import Ephemeris, Polarimeter, Spacecraft, Track
from service.records.epoch import US_PER_S
from service.records.inputs import PolarizationRecord
from service.records.levels.attitude import FloatArray, IntArray

#: so long records are kept
KEPT_US = 1800 * US_PER_S
#: time between two blocks, and age beyond which a record tells nothing
_BLOCK_US, _LATE_US = 300 * US_PER_S, 900 * US_PER_S
#: turn of a feed below which its ratio is no steeper
_STEEP_DEG = 0.5
#: share of a daily wave that changes from day to day, and time in which it becomes another, h
_CHANGED_SHARE, _CHANGED_H = 0.5, 720.0
#: time between two knots of the turn of the orbit, and days of them that are kept
_KNOT_US, _MOST_DAYS = 60 * US_PER_S, 40
#: records of one polarimeter that are kept
_MOST = 120

#: by source, in order of epoch
PolarizationRecords = dict[str, tuple[PolarizationRecord, ...]]


def with_polarization_record(records: PolarizationRecords, record: PolarizationRecord) -> PolarizationRecords:
    """Return the records with one more; those half an hour older than the newest of their source are left out."""
    every = records.get(record.source, ())
    k = bisect_right(every, record.epoch_us, key=_epoch_us)
    every = (*every[:k], record, *every[k:])
    first = bisect_left(every, every[-1].epoch_us - KEPT_US, key=_epoch_us)
    return {**records, record.source: every[max(first, len(every) - _MOST) :]}


def _epoch_us(record: PolarizationRecord) -> int:
    return record.epoch_us


def used_polarimeters(
    spacecraft: Spacecraft | None, contradicted: frozenset[str] = frozenset()
) -> tuple[Polarimeter, ...]:
    """Return the polarimeters that the filter uses, in the order of the catalogue; not those that turns contradict."""
    stated = () if spacecraft is None else spacecraft.polarimeters
    return tuple(each for each in stated if each.used and each.source not in contradicted)


def polarimeter_models(
    spacecraft: Spacecraft | None,
    polarimeters: tuple[Polarimeter, ...],
    calibration: Calibration | None = None,
    epoch_us: int = 0,
) -> tuple[PolarimeterModel, ...]:
    """Return how polarimeters are read; what a calibration told of a feed is known less well by an epoch."""
    result = None if calibration is None else calibration.result
    checks = () if result is None else result.polarimeters
    feeds = {check.source: check.feed for check in checks if check.feed is not None}
    return tuple(
        PolarimeterModel(
            line_of_sight(spacecraft, each),
            each.white_deg,
            each.daily_deg,
            each.wander_deg,
            each.wander_h,
            each.offset_walk_deg_sqrt_h,
            learned_feed(feeds[each.source], each, epoch_us) if each.source in feeds else None,
        )
        for each in polarimeters
        if spacecraft is not None
    )


def learned_feed(feed: FeedFit, polarimeter: Polarimeter, epoch_us: int) -> LearnedFeed:
    """Return the offset and the daily wave that a filter begins with at an epoch: no two days have one wave."""
    turn_deg, cosine_deg, sine_deg = feed.mean
    hours = max(0.0, (epoch_us - feed.stop_us) / US_PER_S / 3600.0)
    changed = _CHANGED_SHARE**2 - math.expm1(-2.0 * hours / _CHANGED_H)
    grown_deg2 = [polarimeter.offset_walk_deg_sqrt_h**2 * hours, *[changed * polarimeter.daily_deg**2] * 2]
    covariance = np.array(feed.covariance) + np.diag(grown_deg2)
    mean = turn_deg - polarimeter.feed_offset_deg, cosine_deg, sine_deg
    return LearnedFeed(mean, tuple(map(tuple, covariance.tolist())))


def every_block(records: Sequence[PolarizationRecord], polarimeter: Polarimeter) -> list[AngleBlock]:
    """Return the blocks of records in order of epoch, one after another."""
    blocks: list[AngleBlock] = []
    for k, one in enumerate(records):
        after_us = blocks[-1].epoch_us if blocks else records[0].epoch_us - 1
        block = due_block(tuple(records[max(0, k + 1 - _MOST) : k + 1]), polarimeter, after_us, one.epoch_us)
        blocks += [] if block is None else [block]
    return blocks


def line_of_sight(spacecraft: Spacecraft, polarimeter: Polarimeter) -> tuple[float, float, float]:
    """Return the turn about the line of sight by yaw, roll and pitch, deg/deg: z, x and y of its unit vector."""
    site = polarimeter.site or spacecraft.receiving_site
    seen = station_direction([site.longitude_deg], [site.latitude_deg], [site.height_m], spacecraft.longitude_deg)
    x, y = math.tan(math.radians(float(seen.azimuth_deg[0]))), -math.tan(math.radians(float(seen.elevation_deg[0])))
    length = math.hypot(x, y, 1.0)
    return 1.0 / length, x / length, y / length


def orbit_turn_deg(
    ephemeris: Ephemeris | None, spacecraft: Spacecraft, sight: tuple[float, float, float], epochs_us: IntArray
) -> FloatArray:
    """Return what the orbit turns a body about a line of sight (T,), deg; 0 without a track, NaN beyond it."""
    if ephemeris is None or ephemeris.track is None:
        return np.zeros(len(epochs_us))
    track = predicted_track(ephemeris.track)
    return np.asarray(frame_turn_deg(track, epochs_us, spacecraft.longitude_deg) @ np.array(sight))


class OrbitTurn:
    """Turn of the orbit about a line of sight, quickly: cubics through knots of a minute.

    Within 1e-8 deg of `orbit_turn_deg`, by the corners between the cubics of the track; its own value near the ends.

    Parameters
    ----------
    ephemeris : Ephemeris
        Orbit that holds.
    spacecraft : Spacecraft
        Whose body it is.
    sight : tuple of float
        Turn about the line by yaw, roll and pitch, deg/deg.
    """

    def __init__(self, ephemeris: Ephemeris, spacecraft: Spacecraft, sight: tuple[float, float, float]) -> None:
        self._rows = partial(orbit_turn_deg, ephemeris, spacecraft, sight)
        self._days: dict[int, list[float]] = {}

    def __call__(self, epoch_us: int) -> float:
        """Return the turn at an epoch, deg; NaN beyond the track."""
        day, within_us = divmod(epoch_us, DAY_US)
        if day not in self._days:
            if len(self._days) >= _MOST_DAYS:
                self._days.clear()
            epochs_us = day * DAY_US + _KNOT_US * np.arange(-1, DAY_US // _KNOT_US + 2, dtype=np.int64)
            self._days[day] = self._rows(epochs_us).tolist()
        knot, left_us = divmod(within_us, _KNOT_US)
        one, two, three, four = self._days[day][knot : knot + 4]
        x = left_us / _KNOT_US
        turned_deg = (x - 1.0) * (x - 2.0) / 2.0 * ((x + 1.0) * two - x / 3.0 * one)
        turned_deg += (x + 1.0) * x / 2.0 * ((x - 1.0) / 3.0 * four - (x - 2.0) * three)
        if math.isnan(turned_deg):
            return float(self._rows(np.array([epoch_us], dtype=np.int64))[0])
        return turned_deg


@lru_cache(maxsize=64)
def predicted_track(track: Track) -> PredictedTrack:
    """Return a track as arrays; nobody may write to them."""
    epochs_us = np.array(track.epochs_us, dtype=np.int64)
    return PredictedTrack(epochs_us, np.array(track.latitude_deg), np.array(track.longitude_deg))


def due_block(
    records: tuple[PolarizationRecord, ...], polarimeter: Polarimeter, after_us: int, epoch_us: int
) -> AngleBlock | None:
    """Return the block that is due at an epoch, of records later than `after_us`; None before, or without any."""
    if not records or records[-1].epoch_us - after_us < _BLOCK_US:
        return None
    since_us = max(after_us, epoch_us - _LATE_US)
    first = bisect_right(records, since_us, key=_epoch_us)
    fresh = records[first : bisect_right(records, epoch_us, lo=first, key=_epoch_us)]
    if not fresh or fresh[-1].epoch_us - after_us < _BLOCK_US or _stands_still(fresh):
        return None
    angles_deg = [measured_angle_deg(each, polarimeter) for each in fresh]
    variance_deg2 = sum(noise_deg(each, polarimeter) ** 2 for each in fresh) / len(fresh)
    powers = [each.co_power_dbm for each in fresh if each.co_power_dbm is not None]
    return AngleBlock(
        fresh[-1].epoch_us,
        _median(angles_deg),
        # of a median of some records
        0.5 * math.pi * variance_deg2 / len(fresh),
        _median(powers) if powers else math.nan,
    )


def _median(numbers: list[float]) -> float:
    """Return the median, NaN where one of the numbers is not finite."""
    return statistics.median(numbers) if all(map(math.isfinite, numbers)) else math.nan


def _stands_still(records: Sequence[PolarizationRecord]) -> bool:
    first = records[0]
    return len(records) > 1 and all(
        (each.ratio_db, each.angle_deg) == (first.ratio_db, first.angle_deg) for each in records
    )


def measured_angle_deg(record: PolarizationRecord, polarimeter: Polarimeter) -> float:
    """Return the angle of a record without the Faraday rotation that is known."""
    rotated = faraday_deg(record.tec_tecu or 0.0, polarimeter.field_t, polarimeter.frequency_hz)
    if record.ratio_db is None:
        return (record.angle_deg or 0.0) - rotated
    return angle_deg(_offset_deg(record, polarimeter), record.ratio_db) - rotated


def noise_deg(record: PolarizationRecord, polarimeter: Polarimeter) -> float:
    """Return one sigma of the white noise of a record; the slope is that of the ratio, whatever the catalogue says."""
    if record.ratio_db is None:
        return polarimeter.white_deg if record.sigma_deg is None else record.sigma_deg
    if record.noise_db is None:
        return polarimeter.white_deg
    return record.noise_db / slope_db_deg(min(max(turned_deg(record.ratio_db), _STEEP_DEG), 90.0 - _STEEP_DEG))


def _offset_deg(record: PolarizationRecord, polarimeter: Polarimeter) -> float:
    return polarimeter.feed_offset_deg if record.feed_offset_deg is None else record.feed_offset_deg
