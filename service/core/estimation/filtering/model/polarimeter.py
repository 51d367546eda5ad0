"""Polarimeter among the hidden states: its angle follows the turn of the body about the line of sight.

    D = 20 lg |tan(d0 + p) + e|                  D dB, ratio of two ports of a feed turned by d0; e leakage
    z = +-atan(10^(D/20)) - d0 = p + b + c cos t + s sin t + a + white      t phase of the solar day
    p = s . (roll, pitch, yaw)                   s unit vector from the spacecraft to the feed, body axes

The arc tangent takes a real leakage as a turn of the feed: the slope is right to 1 % at 35 dB, and what e and an error
of d0 leave is the offset b. States an instrument: b, c, s, and a of some hours, deg. b has a wide prior: the first
angles after an alignment set it, and from then on changes of p count. The law of this file: these states move nothing.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.estimation.filtering.model.filter_model import (
    ATTITUDE,
    DRIFT,
    RATE,
    FilterSettings,
    Gaussian,
    PolarimeterModel,
)
from service.core.estimation.filtering.model.sensor_effect import SensorUpdate
from service.core.estimation.filtering.model.torque_prior import DAY_US

#: states of one polarimeter: offset, daily cosine and sine, wander
POLARIMETER = 4
#: place of the wander among them
WANDER = 3
#: one sigma of the offset of a feed that was moved, deg
FREE_OFFSET_DEG = 3.0
#: slope of the ratio at 45 deg, dB/deg
_SLOPE_DB_DEG = 40.0 / math.log(10.0) * math.radians(1.0)
#: Faraday rotation of 1 TECU at 1 Hz in 1 T, deg
_FARADAY_DEG = math.degrees(2.36e4 * 1e16)


class ComparedAngle(NamedTuple):
    """Angle of a polarimeter compared with the state."""

    innovation_deg: float
    variance_deg2: float
    #: (D,) P H' and H
    cross: FloatArray
    jacobian: FloatArray

    def widened(self, variance_deg2: float) -> "ComparedAngle":
        """Return the same with a noise whose variance is greater."""
        return self._replace(variance_deg2=self.variance_deg2 + variance_deg2)

    @property
    def excess(self) -> float:
        """Return the size of the innovation, sigmas."""
        return abs(self.innovation_deg) / math.sqrt(self.variance_deg2)

    @property
    def update(self) -> SensorUpdate:
        """Return the angle as an update of one measurement."""
        innovation, variance = np.array([self.innovation_deg]), np.array([[self.variance_deg2]])
        return SensorUpdate(self.jacobian[None, :], innovation, variance, self.cross[None, :])


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


def polarimeter_noise(settings: FilterSettings) -> tuple[FloatArray, FloatArray]:
    """Return sigma (4 P,), deg, and correlation time (4 P,), s, of the noise that keeps the states alive."""
    sigma = [one for each in settings.polarimeters for one in (0.0, 0.0, 0.0, each.wander_deg)]
    tau_s = [one for each in settings.polarimeters for one in (math.inf, math.inf, math.inf, 3600.0 * each.wander_h)]
    return np.array(sigma), np.array(tau_s)


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
) -> ComparedAngle:
    """Return an angle against a state of an epoch; `after_h` <= 0 is its age, `first` the place of its offset."""
    phase = 2.0 * math.pi * (epoch_us % DAY_US) / DAY_US
    jacobian, sight = np.zeros(len(gaussian.mean)), np.array(polarimeter.sight)
    jacobian[ATTITUDE] = sight
    jacobian[DRIFT] = jacobian[RATE] = after_h * sight
    jacobian[first : first + POLARIMETER] = 1.0, math.cos(phase), math.sin(phase), 1.0
    cross = gaussian.covariance @ jacobian
    innovation_deg = measured_deg - float(jacobian @ gaussian.mean)
    return ComparedAngle(innovation_deg, float(jacobian @ cross) + variance_deg2, cross, jacobian)


def updated_by_angle(gaussian: Gaussian, found: ComparedAngle) -> Gaussian:
    """Return the state after an angle."""
    gain = found.cross / found.variance_deg2
    covariance = gaussian.covariance - np.multiply.outer(gain, found.cross)
    return Gaussian(gaussian.mean + gain * found.innovation_deg, 0.5 * (covariance + covariance.T))


def with_moved_feed(gaussian: Gaussian, first: int, sigma_deg: float = FREE_OFFSET_DEG) -> Gaussian:
    """Return the state whose offset may have changed by an amount of this sigma."""
    covariance = gaussian.covariance.copy()
    covariance[first, first] += sigma_deg**2
    return Gaussian(gaussian.mean, covariance)
