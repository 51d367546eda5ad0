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
free. The law of this file: these states move nothing.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    DRIFT,
    RATE,
    FilterSettings,
    Gaussian,
    PolarimeterModel,
)
from service.core.estimation.filtering.motion_sensor import (
    GATE,
    NEVER_US,
    NO_EFFECT,
    TRUSTED,
    SensorEffect,
    SensorUpdate,
    SensorWatch,
    judged,
    with_record,
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


def compared_angle(
    gaussian: Gaussian,
    first: int,
    measured_deg: float,
    variance_deg2: float,
    epoch_us: int,
    after_h: float,
    polarimeter: PolarimeterModel,
) -> SensorUpdate:
    """Return an angle against a state of an epoch; `after_h` <= 0 is its age, `first` the place of its offset."""
    phase = 2.0 * math.pi * (epoch_us % DAY_US) / DAY_US
    jacobian, sight = np.zeros(len(gaussian.mean)), np.array(polarimeter.sight)
    jacobian[ATTITUDE] = sight
    jacobian[DRIFT] = jacobian[RATE] = after_h * sight
    jacobian[first : first + POLARIMETER] = 1.0, math.cos(phase), math.sin(phase), 1.0
    cross = gaussian.covariance @ jacobian
    innovation_deg = measured_deg - float(jacobian @ gaussian.mean)
    variance_deg2 = float(jacobian @ cross) + variance_deg2
    return SensorUpdate(jacobian[None, :], np.array([innovation_deg]), np.array([[variance_deg2]]), cross[None, :])


def with_moved_feed(gaussian: Gaussian, first: int, sigma_deg: float = FREE_OFFSET_DEG) -> Gaussian:
    """Return the state whose offset may have changed by an amount of this sigma."""
    covariance = gaussian.covariance.copy()
    covariance[first, first] += sigma_deg**2
    return Gaussian(gaussian.mean, covariance)


def polarimeter_advice(watches: tuple[SensorWatch, ...], epoch_us: int) -> dict[str, bool]:
    """Return which advice about polarimeters is given at an epoch."""
    return {
        "polarimeter_refused": any(watch.is_refused for watch in watches),
        "polarimeter_moved": any(watch.has_jumped(epoch_us) for watch in watches),
        "polarimeter_silent": any(watch.is_silent(NEVER_US, epoch_us) for watch in watches),
    }


def push_block(
    watch: SensorWatch,
    gaussian: Gaussian,
    first: int,
    block: AngleBlock,
    epoch_us: int,
    polarimeter: PolarimeterModel,
) -> tuple[SensorWatch, Gaussian, SensorEffect]:
    """Return watch and state after a block, and its effect.

    The state is that of an epoch not earlier, its offset stands at `first`.
    """
    if watch.is_refused or block.epoch_us <= watch.newest_us:
        return watch, gaussian, NO_EFFECT
    is_first, hours = watch.newest_us == NEVER_US, watch.hours_until(block.epoch_us)
    clear_dbm = _clear_dbm(watch.clear_dbm, block.co_power_dbm, hours)
    watch = with_record(watch, block.epoch_us)._replace(clear_dbm=clear_dbm)
    gaussian = with_moved_feed(gaussian, first, polarimeter.offset_walk_deg_sqrt_h * math.sqrt(hours))
    fade_db = 0.0 if math.isnan(block.co_power_dbm) else max(0.0, abs(clear_dbm - block.co_power_dbm) - _QUIET_DB)
    if fade_db > _DEEP_DB:
        return watch, gaussian, NO_EFFECT
    watch = watch._replace(heard_us=block.epoch_us)
    variance_deg2 = block.variance_deg2 + (_RAIN_DEG_DB * fade_db) ** 2
    after_h = (block.epoch_us - epoch_us) / 3.6e9
    found = compared_angle(gaussian, first, block.angle_deg, variance_deg2, epoch_us, after_h, polarimeter)
    if is_first and polarimeter.learned is not None and found.excess > TRUSTED:
        watch = watch._replace(jumped_us=block.epoch_us) if found.excess > GATE else watch
        gaussian = _with_other_feed(gaussian, first, polarimeter)
        found = compared_angle(gaussian, first, block.angle_deg, variance_deg2, epoch_us, after_h, polarimeter)
    excess = found.excess
    if excess <= GATE:
        found = found.widened(variance_deg2 * (max(excess / TRUSTED, 1.0) ** 2 - 1.0))
        after = judged(watch._replace(skipped=0), found.applied(gaussian), excess**2, _LEAST_BLOCKS)
        return *after, NO_EFFECT._replace(update=found)
    watch = watch._replace(skipped=watch.skipped + 1)
    if watch.skipped < _MOVED_BLOCKS or fade_db > 0.0:
        return *judged(watch, gaussian, excess**2, _LEAST_BLOCKS), NO_EFFECT
    moved = watch.jumped(block.epoch_us)._replace(records=0.0, squares=0.0)
    return *judged(moved, _with_other_feed(gaussian, first, polarimeter), 0.0, _LEAST_BLOCKS), NO_EFFECT


def _with_other_feed(gaussian: Gaussian, first: int, polarimeter: PolarimeterModel) -> Gaussian:
    """Return the state whose offset is free; what a calibration learned of the wave may hold no more."""
    if polarimeter.learned is not None:
        wave = np.arange(first + 1, first + WANDER)
        covariance = gaussian.covariance.copy()
        covariance[wave, wave] += polarimeter.daily_deg**2
        gaussian = Gaussian(gaussian.mean, covariance)
    return with_moved_feed(gaussian, first)


def _clear_dbm(clear_dbm: float, power_dbm: float, hours: float) -> float:
    """Return the power in clear sky: soon where more comes, slowly where less; none is learned of a saturated one."""
    if math.isnan(clear_dbm) or math.isnan(power_dbm) or abs(power_dbm - clear_dbm) > _DEEP_DB:
        return power_dbm if math.isnan(clear_dbm) else clear_dbm
    time_h = _RISE_H if power_dbm > clear_dbm else _FALL_H
    return clear_dbm + (power_dbm - clear_dbm) * -math.expm1(-hours / time_h)
