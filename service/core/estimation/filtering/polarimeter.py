"""Polarimeter among the hidden states: its angle follows the turn of the body about the line of sight.

    D = 20 lg |tan(d0 + p) + e|                  D dB, ratio of two ports of a feed turned by d0; e leakage
    z = +-atan(10^(D/20)) - d0 = p + b + c cos t + s sin t + a + white      t phase of the solar day
    p = s . (roll, pitch, yaw)                   s unit vector from the spacecraft to the feed, body axes

The arc tangent takes a real leakage as a turn of the feed: the slope is right to 1 % at 35 dB, and what e and an error
of d0 leave is the offset b. States an instrument: b, c, s, and a of some hours, deg. b has a wide prior: the first
angles after an alignment set it, and from then on changes of p count.

Angles are judged block by block, some minutes of records. Three left out in a row in quiet co-polar power are a moved
feed: the offset is free again. A fade of the co-polar port widens, a deep one leaves the block out. At an alignment yaw
is known: a first block beyond two sigma says that a feed does not stand where the calibration saw it, and its offset is
free. The law of this file: these states move nothing. What takes a block is compiled as it stands.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray
from service.core.estimation.filtering.filter_model import DRIFT, RATE, FilterSettings, Gaussian
from service.core.estimation.filtering.filter_state import NEVER_US
from service.core.estimation.filtering.motion_sensor import (
    GATE,
    TRUSTED,
    SensorInnovation,
    begin_record,
    count_jump,
    greatest_excess,
    hours_since,
    judge_record,
    use_record,
)
from service.core.estimation.filtering.plant import DAY_US, POLARIMETER, WANDER

#: one sigma of the offset of a feed that was moved, deg
FREE_OFFSET_DEG = 3.0
#: slope of the ratio at 45 deg, dB/deg
_SLOPE_DB_DEG = 40.0 / math.log(10.0) * math.radians(1.0)
#: Faraday rotation of 1 TECU at 1 Hz in 1 T, deg
_FARADAY_DEG = math.degrees(2.36e4 * 1e16)


#: blocks left out in a row that are a moved feed, and fewest blocks of which a mean is judged
_MOVED_BLOCKS, _LEAST_BLOCKS = 3, 12.0
#: fade of the co-polar port that is none, one too deep, dB, and sigma of the turn by it, deg/dB: rain lasts for blocks
_QUIET_DB, _DEEP_DB, _RAIN_DEG_DB = 0.3, 5.0, 0.2
#: time in which the power in clear sky is learned upwards and forgotten, h
_RISE_H, _FALL_H = 0.5, 24.0


class AngleBlock(NamedTuple):
    """Some minutes of a polarimeter."""

    epoch_us: int
    angle_deg: float
    variance_deg2: float
    #: NaN = not stated
    co_power_dbm: float


def ratio_db(feed_offset_deg: float, angle_deg: float, leakage: float = 0.0) -> float:
    """Return the ratio of the ports, dB, at an angle of the polarisation."""
    return 20.0 * math.log10(abs(math.tan(math.radians(feed_offset_deg + angle_deg)) + leakage))


def turned_deg(measured_db: float) -> float:
    """Return the turn of the feed against the polarisation, 0..90 deg, at a ratio of the ports."""
    return math.degrees(math.atan(10.0 ** (measured_db / 20.0)))


def angle_deg(feed_offset_deg: float, measured_db: float) -> float:
    """Return the angle of the polarisation at a ratio of the ports, for a feed turned by -90..90 deg, not 0.

    Examples
    --------
    >>> round(angle_deg(10.0, ratio_db(10.0, 0.3)), 6), round(angle_deg(-10.0, ratio_db(-10.0, 0.3)), 6)
    (0.3, 0.3)
    """
    return math.copysign(turned_deg(measured_db), feed_offset_deg) - feed_offset_deg


def slope_db_deg(feed_offset_deg: float) -> float:
    """Return the slope of the ratio, dB/deg.

    Examples
    --------
    >>> [round(slope_db_deg(offset), 2) for offset in (45.0, 10.0, 5.0, 2.0)]
    [0.3, 0.89, 1.75, 4.35]
    """
    return _SLOPE_DB_DEG / math.sin(math.radians(2.0 * feed_offset_deg))


def faraday_deg(tec_tecu: float, field_t: float, frequency_hz: float) -> float:
    """Return the Faraday rotation of an electron content along the path, deg, in a field along the downlink.

    Examples
    --------
    >>> round(faraday_deg(30.0, 4e-5, 11e9), 3)
    0.134
    """
    return _FARADAY_DEG * field_t * tec_tecu / frequency_hz**2


def polarimeter_covariance(settings: FilterSettings) -> FloatArray:
    """Return the covariance (4 P, 4 P) before the first angle, deg^2."""
    sigma = [
        one
        for each in settings.polarimeters
        for one in (FREE_OFFSET_DEG, each.daily_deg, each.daily_deg, each.wander_deg)
    ]
    return np.diag(np.square(sigma))


def with_learned_feeds(gaussian: Gaussian, first: int, settings: FilterSettings) -> Gaussian:
    """Return the state with what quiet days and turns tell of the feeds, where they told something."""
    if all(each.learned is None for each in settings.polarimeters):
        return gaussian
    mean, covariance = gaussian.mean.copy(), gaussian.covariance.copy()
    for number, each in enumerate(settings.polarimeters):
        if each.learned is not None:
            own = slice(first + POLARIMETER * number, first + POLARIMETER * number + WANDER)
            mean[own], covariance[own, own] = np.array(each.learned.mean), np.array(each.learned.covariance)
    return Gaussian(mean, covariance)


def compare_angle(
    feed: NDArray[np.void],
    mean: FloatArray,
    covariance: FloatArray,
    first: int,
    block: AngleBlock,
    variance_deg2: float,
    epoch_us: int,
) -> SensorInnovation:
    """Return a block against a state of a not earlier epoch, whose offset stands at `first`.

    Its noise is greater by a variance; the phase of the daily wave is that of the state.
    """
    phase, after_h = 2.0 * math.pi * (epoch_us % DAY_US) / DAY_US, (block.epoch_us - epoch_us) / 3.6e9
    jacobian = np.zeros((1, len(mean)))
    for axis in range(3):
        jacobian[0, axis] = feed["sight"][axis]
        jacobian[0, DRIFT.start + axis] = jacobian[0, RATE.start + axis] = after_h * feed["sight"][axis]
    jacobian[0, first], jacobian[0, first + WANDER] = 1.0, 1.0
    jacobian[0, first + 1], jacobian[0, first + 2] = math.cos(phase), math.sin(phase)
    innovation_deg = block.angle_deg - jacobian @ mean
    cross = jacobian @ covariance
    return SensorInnovation(jacobian, innovation_deg, cross @ jacobian.T + (block.variance_deg2 + variance_deg2), cross)


def push_angle(
    feed: NDArray[np.void],
    watch: NDArray[np.void],
    mean: FloatArray,
    covariance: FloatArray,
    first: int,
    block: AngleBlock,
    epoch_us: int,
    trace_rows: FloatArray,
) -> None:
    """Take a block into watch and state, in place.

    The state is that of an epoch not earlier, its offset stands at `first`; `trace_rows` as `use_record` writes it.
    """
    if watch["is_refused"] or block.epoch_us <= watch["newest_us"]:
        return
    is_first, hours = watch["newest_us"] == NEVER_US, hours_since(watch, block.epoch_us)
    clear_dbm = _clear_dbm(float(watch["clear_dbm"]), block.co_power_dbm, hours)
    begin_record(watch, block.epoch_us)
    watch["clear_dbm"] = clear_dbm
    covariance[first, first] += feed["offset_walk_deg_sqrt_h"] ** 2 * hours
    fade_db = 0.0 if math.isnan(block.co_power_dbm) else max(0.0, abs(clear_dbm - block.co_power_dbm) - _QUIET_DB)
    if fade_db > _DEEP_DB:
        return
    watch["heard_us"] = block.epoch_us
    rain_deg2 = (_RAIN_DEG_DB * fade_db) ** 2
    compared = compare_angle(feed, mean, covariance, first, block, rain_deg2, epoch_us)
    excess = greatest_excess(compared)
    if is_first and feed["is_learned"] and excess > TRUSTED:
        if excess > GATE:
            watch["jumped_us"] = block.epoch_us
        _free_feed(covariance, first, feed)
        compared = compare_angle(feed, mean, covariance, first, block, rain_deg2, epoch_us)
        excess = greatest_excess(compared)
    if excess <= GATE:
        variance_deg2 = (block.variance_deg2 + rain_deg2) * (max(excess / TRUSTED, 1.0) ** 2 - 1.0)
        use_record(mean, covariance, compared, variance_deg2, trace_rows)
        watch["skipped"] = 0
        judge_record(watch, covariance, excess**2, _LEAST_BLOCKS, 0.0)
        return
    watch["skipped"] += 1
    if watch["skipped"] < _MOVED_BLOCKS or fade_db > 0.0:
        judge_record(watch, covariance, excess**2, _LEAST_BLOCKS, 0.0)
        return
    count_jump(watch, block.epoch_us)
    watch["records"] = watch["squares"] = 0.0
    _free_feed(covariance, first, feed)
    judge_record(watch, covariance, 0.0, _LEAST_BLOCKS, 0.0)


def _free_feed(covariance: FloatArray, first: int, feed: NDArray[np.void]) -> None:
    """Let the offset be free, in place; what a calibration learned of the wave may hold no more."""
    covariance[first, first] += FREE_OFFSET_DEG**2
    if feed["is_learned"]:
        for place in range(first + 1, first + WANDER):
            covariance[place, place] += feed["daily_deg"] ** 2


def _clear_dbm(clear_dbm: float, power_dbm: float, hours: float) -> float:
    """Return the power in clear sky: soon where more comes, slowly where less; none is learned of a saturated one."""
    if math.isnan(clear_dbm) or math.isnan(power_dbm) or abs(power_dbm - clear_dbm) > _DEEP_DB:
        return power_dbm if math.isnan(clear_dbm) else clear_dbm
    time_h = _RISE_H if power_dbm > clear_dbm else _FALL_H
    return clear_dbm + (power_dbm - clear_dbm) * -math.expm1(-hours / time_h)
