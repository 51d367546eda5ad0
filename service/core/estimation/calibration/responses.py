"""Responses of polarimeter, wheel momentum and body rates to the calibration turns: signs, order and scales.

Torque from outside that gathers in the wheels, by their telemetry on quiet days, when sensors tell the angles:

    H' = w x H + T,   T = constant + cosine cos(p) + sine sin(p),   records as in `wheel_momentum`

A misalignment of the wheels about roll or yaw looks like a constant torque; days of one attitude do not tell them
apart, but what they are together, which is what a filter needs that predicts the same wheels. Records of feeds and
wheels are taken by the filter's own equations and its own judgement, at angles that are known.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    RATE,
    FilterSettings,
    Gaussian,
    LearnedFeed,
    PolarimeterModel,
    no_carriers,
)
from service.core.estimation.filtering.filter_state import initial_sensors
from service.core.estimation.filtering.plant import POLARIMETER, TORQUES, WANDER, filter_model, torque_covariance
from service.core.estimation.filtering.polarimeter import AngleBlock, polarimeter_covariance, push_angle
from service.core.estimation.filtering.wheel_momentum import (
    WheelRecord,
    learned_positions,
    momentum_covariance,
    moved_momentum,
    push_momentum,
)

#: records are averaged over so much, h
_BLOCK_H = 1.0 / 12.0
_SLOW_DEGREE = 3
#: fewest means beyond the unknowns
_LEAST_FREE_OF_ANGLES = 6
#: the response counts as determined up to this sigma
DETERMINED = 0.2
#: share by which wander and the sensor may make the response wrong
_WANDER_SHARE = 0.05


class AngleResponse(NamedTuple):
    """Response of an angle to the turns; NaN = not determined."""

    coefficient: float
    sigma: float

    @property
    def is_determined(self) -> bool:
        """Return whether the turns tell sign and scale."""
        return self.sigma <= DETERMINED

    def deviation(self) -> float:
        """Return the deviation from a true instrument, sigmas; 0 where the turns tell nothing."""
        if not self.sigma <= DETERMINED * max(1.0, abs(self.coefficient)):
            return 0.0
        return abs(self.coefficient - 1.0) / math.hypot(self.sigma, _WANDER_SHARE)


def angle_response(epochs_h: FloatArray, measured_deg: FloatArray, expected_deg: FloatArray) -> AngleResponse:
    """Return the response of a measured angle to the expected one.

    Parameters
    ----------
    epochs_h : ndarray, shape (K,), h
        Epochs of the records, ascending.
    measured_deg, expected_deg : ndarray, shape (K,), deg
        Angle about the line of sight by the polarimeter and by the sensors; records with NaN take no part.
    """
    known = np.isfinite(measured_deg) & np.isfinite(expected_deg)
    unknown = AngleResponse(math.nan, math.nan)
    if not known.any():
        return unknown
    block = np.floor((epochs_h[known] - epochs_h[known][0]) / _BLOCK_H).astype(np.int64)
    _, mean_of, count = np.unique(block, return_inverse=True, return_counts=True)
    mean_h, mean_measured, mean_expected = (
        np.bincount(mean_of, values[known]) / count for values in (epochs_h, measured_deg, expected_deg)
    )
    span = max(float(np.ptp(mean_h)), _BLOCK_H)
    slow = np.vander((mean_h - mean_h.mean()) / span, _SLOW_DEGREE + 1)
    solved, sigma = _regression(np.column_stack([mean_expected, slow]), mean_measured[:, None], _LEAST_FREE_OF_ANGLES)
    return AngleResponse(float(solved[0, 0]), float(sigma[0, 0]))


def _regression(design: FloatArray, values: FloatArray, least_free: int) -> tuple[FloatArray, FloatArray]:
    """Return coefficients (U, M) of values (K, M) on a design (K, U), and their sigmas by the scatter; NaN without."""
    free, size = len(values) - design.shape[1], (design.shape[1], values.shape[1])
    if free < least_free or np.linalg.matrix_rank(design) < design.shape[1]:
        return np.full(size, np.nan), np.full(size, np.nan)
    solved = np.asarray(np.linalg.lstsq(design, values, rcond=None)[0])
    scatter = np.square(values - design @ solved).sum(axis=0) / free
    return solved, np.sqrt(np.outer(np.linalg.inv(design.T @ design).diagonal(), scatter))


#: behind attitude, drift and rates
_FIRST = RATE.stop
_US_PER_H = 3.6e9
#: leakage of a feed of 35 dB of isolation, one sigma of its real part
_LEAKAGE = 10.0 ** (-35.0 / 20.0) / math.sqrt(2.0)


class Leakage(NamedTuple):
    """Leakage of a feed, real part, and one standard deviation; deg, as the turn that it looks like."""

    leakage_deg: float
    sigma_deg: float


def feed_turn(blocks: Sequence[AngleBlock], polarimeter: PolarimeterModel) -> LearnedFeed | None:
    """Return what blocks tell of the feed; None where there are none, or they contradict one another.

    Parameters
    ----------
    blocks : sequence of AngleBlock
        Of quiet days and turns, ascending; their angles less those about the line of sight by the sensors.
    polarimeter : PolarimeterModel
        As the catalogue states it.
    """
    if not blocks:
        return None
    settings = FilterSettings(polarimeters=(polarimeter,))
    covariance = np.zeros((_FIRST + POLARIMETER,) * 2)
    covariance[_FIRST:, _FIRST:] = polarimeter_covariance(settings)
    gaussian, newest_us = Gaussian(np.zeros(len(covariance)), covariance), blocks[0].epoch_us
    watch, feed = initial_sensors(1, newest_us)[1], filter_model(no_carriers(), settings).feeds[0]
    for block in blocks:
        gaussian = _wandered(gaussian, (block.epoch_us - newest_us) / _US_PER_H, polarimeter)
        newest_us = block.epoch_us
        push_angle(feed, watch, *gaussian, _FIRST, block, newest_us, np.zeros((0, 0)))
    if watch["is_refused"]:
        return None
    own = slice(_FIRST, _FIRST + WANDER)
    return LearnedFeed(tuple(gaussian.mean[own].tolist()), tuple(map(tuple, gaussian.covariance[own, own].tolist())))


def feed_leakage(response: AngleResponse, turn_deg: float) -> Leakage:
    """Return the leakage by the slope of the angle on the turns of the body and by the isolation of a usual feed.

    Parameters
    ----------
    response : AngleResponse
        Response of the angle to the turns, 1 - e sin(2 d0).
    turn_deg : float, deg
        Turn of the feed, its leakage taken for a turn.
    """
    slope = math.sin(math.radians(2.0 * turn_deg))
    weight = 1.0 / _LEAKAGE**2
    if not response.is_determined:
        return Leakage(0.0, math.degrees(_LEAKAGE))
    turned = (slope / response.sigma) ** 2
    leakage = (1.0 - response.coefficient) / slope * turned / (turned + weight)
    return Leakage(math.degrees(leakage), math.degrees(1.0 / math.sqrt(turned + weight)))


def _wandered(gaussian: Gaussian, hours: float, polarimeter: PolarimeterModel) -> Gaussian:
    """Return the state after a time in which only the wander moves."""
    keep = np.ones(len(gaussian.mean))
    keep[_FIRST + WANDER] = kept = math.exp(-hours / polarimeter.wander_h)
    covariance = keep[:, None] * gaussian.covariance * keep
    covariance[_FIRST + WANDER, _FIRST + WANDER] += (1.0 - kept**2) * polarimeter.wander_deg**2
    return Gaussian(keep * gaussian.mean, covariance)


_ORBITAL_RATE_RAD_S = 7.292115e-5
#: turns change a record by this share of the greatest momentum and angle at most; what changes it more is a jump
_JUMP_SHARE = 3.0
#: fewest records beyond the unknowns of an axis
_LEAST_FREE_OF_MOMENTUM = 4
#: share by which noise of the sensor may make a coefficient too small
_SENSOR_SHARE = 0.02


class MomentumResponse(NamedTuple):
    """Response of the momentum to the turns; order roll, pitch, yaw.

    Parameters
    ----------
    coefficient, sigma : ndarray, shape (3,)
        a and one standard deviation; NaN = not determined.
    mean_n_m_s : ndarray, shape (3,), N m s
        Mean of the records that were used.
    records : int
        Records that were used: the longest stretch without jump or unloading, without slews.
    stretches : int
        Stretches that jumps and unloadings make of the turns.
    """

    coefficient: FloatArray
    sigma: FloatArray
    mean_n_m_s: FloatArray
    records: int
    stretches: int

    @property
    def is_determined(self) -> bool:
        """Return whether the turns tell the response along roll and yaw."""
        return bool((self.sigma[[0, 2]] <= DETERMINED).all())

    def deviation(self, scale_error: float) -> float:
        """Return the greatest deviation from true telemetry of a stated scale error, sigmas; 0 without any response.

        Each axis is judged, and roll and yaw together, which a wrong pitch axis moves alike.
        """
        known = self.sigma <= DETERMINED
        if not known.any():
            return 0.0
        off = self.coefficient[known] - 1.0
        own = np.hypot(self.sigma[known], np.hypot(np.sqrt(2.0) * scale_error, _SENSOR_SHARE))
        single = float(np.abs(off / own).max())
        if not self.is_determined:
            return single
        both = 1.0 / np.square(own[[0, -1]])
        return max(single, float(abs(both @ off[[0, -1]]) / np.sqrt(both.sum())))


def momentum_response(
    epochs_s: FloatArray,
    reported_n_m_s: FloatArray,
    attitude_deg: FloatArray,
    is_slewing: BoolArray,
    is_unloading: BoolArray,
    inertia_kg_m2: FloatArray,
) -> MomentumResponse:
    """Return the response of the reported momentum to the turns.

    Parameters
    ----------
    epochs_s : ndarray, shape (K,), s
        Epochs of the records, ascending.
    reported_n_m_s : ndarray, shape (K, 3), N m s
        Momentum of the wheels along roll, pitch, yaw of the body.
    attitude_deg : ndarray, shape (K, 3), deg
        Yaw, roll, pitch by the sensors; NaN rows take no part.
    is_slewing : ndarray of bool, shape (K,)
        The spacecraft turns: its own momentum is in the record.
    is_unloading : ndarray of bool, shape (K,)
        Thrusters unload the wheels at the record.
    inertia_kg_m2 : ndarray, shape (3,), kg m^2
        About roll, pitch, yaw.
    """
    known = np.isfinite(attitude_deg).all(axis=1) & np.isfinite(reported_n_m_s).all(axis=1)
    reach_rad = float(np.radians(np.abs(attitude_deg[known]).max(initial=0.0)))
    label = _stretches(reported_n_m_s, reach_rad, is_unloading)
    usable = known & ~is_slewing & ~is_unloading
    counts = np.bincount(label[usable], minlength=1)
    used = usable & (label == int(np.argmax(counts)))
    momentum = reported_n_m_s[used]
    turned = _turned(momentum, np.radians(attitude_deg[used]), inertia_kg_m2)
    slow = _slow(epochs_s[used])
    axes = [(np.column_stack([turned[:, axis], slow]), momentum[:, axis, None]) for axis in range(3)]
    fits = np.array([[part[0, 0] for part in _regression(*one, _LEAST_FREE_OF_MOMENTUM)] for one in axes])
    mean = momentum.mean(axis=0) if len(momentum) else np.full(3, np.nan)
    return MomentumResponse(fits[:, 0], fits[:, 1], mean, int(used.sum()), int(label.max(initial=-1)) + 1)


def _stretches(reported: FloatArray, reach_rad: float, is_unloading: BoolArray) -> NDArray[np.int64]:
    """Return the number (K,) of the stretch of each record; an unloading or a jump begins the next one."""
    if not len(reported):
        return np.zeros(0, dtype=np.int64)
    step = np.abs(np.diff(reported, axis=0)).max(axis=1)
    size = float(np.median(np.linalg.norm(reported, axis=1)))
    # scatter of a record, with a floor for a momentum that is reported in steps
    scatter = 1.4826 * float(np.median(step)) if len(step) else 0.0
    is_jump = step > _JUMP_SHARE * (size * reach_rad + 2.0 * scatter)
    begins = np.append(False, is_jump) | is_unloading
    begins[0] = False
    return np.cumsum(begins).astype(np.int64)


def _turned(momentum: FloatArray, attitude: FloatArray, inertia: FloatArray) -> FloatArray:
    """Return what turns (K, 3) rad move of the momentum (K, 3) along roll, pitch, yaw."""
    (yaw, roll, pitch), (x, y, z) = attitude.T, momentum.T
    about_roll, about_yaw = (inertia[[0, 2]] - inertia[1]) * _ORBITAL_RATE_RAD_S
    return np.column_stack([(y + about_roll) * yaw - z * pitch, z * roll - x * yaw, x * pitch - (y + about_yaw) * roll])


def _slow(epochs_s: FloatArray) -> FloatArray:
    """Return the columns (K, 4) of the slow motion."""
    span = float(np.ptp(epochs_s)) if len(epochs_s) else 0.0
    if span == 0.0:
        return np.ones((len(epochs_s), 1))
    scaled = 2.0 * (epochs_s - epochs_s[0]) / span - 1.0
    return np.polynomial.legendre.legvander(scaled, _SLOW_DEGREE)


_ORBITAL_RATE_PER_H = 0.2625162
#: records are taken together until they span so much, and those further apart tell nothing, h
_SPAN_H, _APART_H = 1.0 / 60.0, 1.0 / 6.0
#: share by which epochs and readings of a record may make a coefficient wrong, and the same of the rate at rest, deg/h
_EPOCH_SHARE, _REST_DEG_H = 0.03, 0.1
#: fewest spans beyond the unknowns of an axis
_LEAST_FREE_OF_RATES = 10


class RateResponse(NamedTuple):
    """Response of the rates to the turns; order yaw, roll, pitch.

    Parameters
    ----------
    coefficient, sigma : ndarray, shape (3, 3)
        A and one standard deviation; NaN = not determined.
    rest_deg_h, rest_sigma_deg_h : ndarray, shape (3,), deg/h
        c and one standard deviation.
    spans : int
        Spans that were compared.
    """

    coefficient: FloatArray
    sigma: FloatArray
    rest_deg_h: FloatArray
    rest_sigma_deg_h: FloatArray
    spans: int

    @property
    def is_determined(self) -> bool:
        """Return whether the turns tell the response to each axis."""
        return bool((self.sigma.diagonal() <= DETERMINED).all())

    def deviation(self, bias_deg_h: float) -> float:
        """Return the greatest deviation from true telemetry of a bias of a size, sigmas; 0 without any response."""
        if not self.spans:
            return 0.0
        off = np.abs(self.coefficient - np.eye(3)) / np.hypot(self.sigma, _EPOCH_SHARE)
        is_known = self.sigma <= DETERMINED * np.maximum(1.0, np.abs(self.coefficient))
        rest = np.abs(self.rest_deg_h) / np.hypot(self.rest_sigma_deg_h, np.hypot(_REST_DEG_H, bias_deg_h))
        return float(np.max(np.concatenate([off[is_known], rest])))


def rate_response(epochs_h: FloatArray, reported_deg_h: FloatArray, attitude_deg: FloatArray) -> RateResponse:
    """Return the response of the reported rates to the turns.

    Parameters
    ----------
    epochs_h : ndarray, shape (K,), h
        Epochs of the records, ascending.
    reported_deg_h : ndarray, shape (K, 3), deg/h
        Mean rates since the record before, yaw, roll, pitch.
    attitude_deg : ndarray, shape (K, 3), deg
        Yaw, roll, pitch by the sensors; spans from or to NaN take no part.
    """
    edges = _edges(epochs_h)
    gained = np.vstack([np.zeros(3), np.cumsum(reported_deg_h[1:] * np.diff(epochs_h)[:, None], axis=0)])
    span = np.diff(epochs_h[edges])[:, None]
    mean, angles = np.diff(gained[edges], axis=0) / span, attitude_deg[edges]
    yaw, roll, _ = (0.5 * (angles[1:] + angles[:-1])).T
    turned = np.diff(angles, axis=0) / span
    turned += _ORBITAL_RATE_PER_H * np.column_stack([roll, -yaw, np.zeros(len(yaw))])
    used = np.isfinite(turned).all(axis=1) & np.isfinite(mean).all(axis=1) & (span[:, 0] <= _APART_H)
    design = np.column_stack([mean[used], np.ones(used.sum())])
    solved, sigma = _regression(design, turned[used], _LEAST_FREE_OF_RATES)
    spans = int(used.sum()) if np.isfinite(sigma).all() else 0
    return RateResponse(solved[:3].T, sigma[:3].T, solved[3], sigma[3], spans)


def _edges(epochs_h: FloatArray) -> NDArray[np.int64]:
    """Return the records (k,) that bound spans."""
    edges: list[int] = []
    for number, epoch_h in enumerate(epochs_h.tolist()):
        # a millisecond less: epochs come in hours
        if not edges or epoch_h - epochs_h[edges[-1]] >= _SPAN_H - 3e-7:
            edges.append(number)
    return np.array(edges, dtype=np.int64)


#: behind attitude, drift and rates stand the torques, then the wheels
_FIRST_WHEEL = RATE.stop + TORQUES


class GatheredFit(NamedTuple):
    """Torque and errors of the telemetry in the order of `LearnedMomentum`, and the records taken."""

    mean: FloatArray
    covariance: FloatArray
    records: int


def gathered_torque(
    epochs_us: IntArray,
    reported_n_m_s: FloatArray,
    attitude_deg: FloatArray,
    attitude_sigma_deg: FloatArray,
    is_unloading: BoolArray,
    settings: FilterSettings,
) -> GatheredFit | None:
    """Return the torque that gathered in the wheels; None where the records contradict the model.

    Parameters
    ----------
    epochs_us : ndarray, shape (K,), microseconds UTC
        Epochs of the records, ascending.
    reported_n_m_s : ndarray, shape (K, 3), N m s
        Momentum of the wheels along roll, pitch, yaw of the body.
    attitude_deg : ndarray, shape (K, 3), deg
        Yaw, roll, pitch by the sensors; NaN rows take no part.
    attitude_sigma_deg : ndarray, shape (3,), deg
        Noise of the sensors at a record.
    is_unloading : ndarray of bool, shape (K,)
        Thrusters unload the wheels at the record.
    settings : FilterSettings
        With the momentum, its torque unknown and the only one.

    Raises
    ------
    ValueError
        The settings have no momentum.
    """
    wheels = settings.momentum
    if wheels is None:
        message = "a torque that gathers needs settings with the momentum of wheels"
        raise ValueError(message)
    gaussian, watch = _beginning(settings, momentum_covariance(settings, wheels)), initial_sensors(0, 0)[0]
    model = filter_model(no_carriers(), settings)
    known = np.isfinite(attitude_deg).all(axis=1) & np.isfinite(reported_n_m_s).all(axis=1)
    newest_us = int(epochs_us[known][0]) if known.any() else 0
    for k in np.flatnonzero(known).tolist():
        epoch_us = int(epochs_us[k])
        moved = moved_momentum(gaussian, _FIRST_WHEEL, newest_us, epoch_us - newest_us, settings)
        gaussian = _at_attitude(moved, attitude_deg[k], attitude_sigma_deg)
        record = WheelRecord(epoch_us, reported_n_m_s[k], bool(is_unloading[k]))
        push_momentum(model, watch, *gaussian, _FIRST_WHEEL, record, epoch_us, np.zeros((0, 0)))
        newest_us = epoch_us
    if watch["is_refused"]:
        return None
    own = learned_positions(_FIRST_WHEEL, settings)
    return GatheredFit(gaussian.mean[own], gaussian.covariance[np.ix_(own, own)], int(known.sum()))


def _beginning(settings: FilterSettings, sensor: FloatArray) -> Gaussian:
    """Return the state before the first record, by the covariance of the telemetry's errors."""
    covariance = np.zeros((_FIRST_WHEEL + len(sensor),) * 2)
    covariance[RATE.stop : _FIRST_WHEEL, RATE.stop : _FIRST_WHEEL] = torque_covariance(settings)
    covariance[_FIRST_WHEEL:, _FIRST_WHEEL:] = sensor
    return Gaussian(np.zeros(len(covariance)), covariance)


def _at_attitude(gaussian: Gaussian, attitude_deg: FloatArray, sigma_deg: FloatArray) -> Gaussian:
    """Return the state at angles that sensors tell."""
    mean, covariance = gaussian.mean.copy(), gaussian.covariance.copy()
    mean[ATTITUDE] = attitude_deg
    covariance[ATTITUDE, :] = covariance[:, ATTITUDE] = 0.0
    covariance[ATTITUDE, ATTITUDE] = np.diag(sigma_deg**2)
    return Gaussian(mean, covariance)
