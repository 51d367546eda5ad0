"""Columns of the joint calibration: level, the daily change of the users' dishes, the beams, the downlink.

``P_i = h_i + D_i(t) + S_i(t) + g_i' d + d' H_i d / 2 + g_b' (d_rx - d_i)``: levels in dBm; d the displacement of the
station in the antenna frame in deg, by attitude and by orbit together; g in dB/deg, H in dB/deg^2, g_b the downlink
gradient of band b. ``D_i`` is the dish law ``b1 m1 + b2 m2 - k |m|^2`` where the motion m of the satellite in the
station's sky is known (``service.core.geometry.line_of_sight``), and two harmonics of the node's phase where it is not.
``S_i`` is the wave of the solar day, of amplifiers that warm and cool.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.calibration.quadratic_response import displacement_matrix

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Own coefficients of the beam, last in the columns: g_az, g_el, H_az_az, H_az_el, H_el_el.
BEAM_SIZE = 5
#: Those of the solar day, before the beam.
SOLAR_SIZE = 2
#: One sigma of each coefficient before the data: level against a rough one (dB), b (dB/deg), k (dB/deg^2), harmonics
#: (dB), solar day (dB), g (dB/deg), H (dB/deg^2), downlink gradient (dB/deg). Beams and harmonics are wide: a shaped
#: beam has g 4 and H 5. Dish and solar day are not: over three days they look alike, and only their sizes tell them
#: apart. The published 0.35 dB at 0.05 deg is b = 7 dB/deg, a dish of 0.3 deg has k 130, links show 0.24 dB peak to
#: peak by day. On `nominal` a b of 50 instead leaves 0.054 instead of 0.026 dB on day 7.
LEVEL_PRIOR_DB = 1e3
_DISH_PRIOR = (8.0, 8.0, 150.0)
_HARMONIC_PRIOR_DB = 10.0
_SOLAR_PRIOR_DB = 0.06
_BEAM_PRIOR = (10.0, 10.0, 15.0, 15.0, 15.0)
DOWNLINK_PRIOR_DB_PER_DEG = 1.5


class CarrierGeometry(NamedTuple):
    """Directions to the stations of N carriers and to the receiving site in the antenna frame.

    Parameters
    ----------
    azimuth_deg, elevation_deg : ndarray, shape (N,), deg
        Stations, from ``station_direction``; NaN for a beacon, which has no beam of its own to move in.
    site_deg : ndarray, shape (2,), deg
        Azimuth and elevation of the receiving site.
    band : ndarray of int, shape (N,)
        Number of the downlink band of each carrier, 0 to R - 1.
    """

    azimuth_deg: FloatArray
    elevation_deg: FloatArray
    site_deg: FloatArray
    band: IntArray

    @property
    def bands(self) -> int:
        """Number of bands."""
        return int(self.band.max(initial=0)) + 1

    def displacement(self) -> FloatArray:
        """Return D of the stations and, last, of the site, shape (N + 1, 2, 3); zeros for a beacon."""
        azimuth_deg = np.append(self.azimuth_deg, self.site_deg[0])
        matrix = displacement_matrix(azimuth_deg, np.append(self.elevation_deg, self.site_deg[1]))
        return np.where(np.isnan(azimuth_deg)[:, np.newaxis, np.newaxis], 0.0, matrix)


class OrbitMotion(NamedTuple):
    """Motion of the satellite by ballistics at T epochs; NaN where there is no ephemeris.

    Parameters
    ----------
    sight_deg : ndarray, shape (T, N, 2), deg
        m, motion of the satellite in the sky of each station.
    antenna_deg : ndarray, shape (T, N + 1, 2), deg
        Motion of the stations and, last, of the receiving site in the antenna frame; zeros where it is neglected.
    """

    sight_deg: FloatArray
    antenna_deg: FloatArray


def daily_columns(motion: OrbitMotion | None, phase_rad: FloatArray, carriers: int) -> FloatArray:
    """Return the columns of the daily change.

    Parameters
    ----------
    motion : OrbitMotion or None
        Ballistics; None takes two harmonics.
    phase_rad : ndarray, shape (T,), rad
        Phase since the ascending node, read when there is no motion.
    carriers : int
        N.

    Returns
    -------
    ndarray, shape (T, N, 3) or (T, N, 4)
        ``m1, m2, -|m|^2`` or ``cos, sin`` of the phase and of twice the phase.

    Examples
    --------
    >>> daily_columns(None, np.array([0.0]), 1)
    array([[[1., 0., 1., 0.]]])
    """
    if motion is not None:
        return np.concatenate([motion.sight_deg, -np.square(motion.sight_deg).sum(axis=-1, keepdims=True)], axis=-1)
    angles = np.multiply.outer(phase_rad, np.array([1.0, 2.0]))
    waves = np.stack([np.cos(angles), np.sin(angles)], axis=-1).reshape(-1, 1, 4)
    return np.repeat(waves, carriers, axis=1)


def solar_columns(midnight_s: FloatArray, carriers: int) -> FloatArray:
    """Return cosine and sine of the solar day, shape (T, N, 2), of seconds (T,) since a midnight UTC."""
    angle = 2.0 * np.pi * np.mod(midnight_s, 86_400.0) / 86_400.0
    return np.repeat(np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, np.newaxis], carriers, axis=1)


def beam_columns(
    attitude_deg: FloatArray, geometry: CarrierGeometry, motion: OrbitMotion | None
) -> tuple[FloatArray, FloatArray]:
    """Return the columns of the beams and of the downlink gradients.

    Parameters
    ----------
    attitude_deg : ndarray, shape (T, 3), deg
        Yaw, roll, pitch.
    geometry : CarrierGeometry
        Stations.
    motion : OrbitMotion or None
        Ballistics; None leaves the motion of the orbit out.

    Returns
    -------
    own : ndarray, shape (T, N, 5)
        Of g_az, g_el, H_az_az, H_az_el, H_el_el.
    downlink : ndarray, shape (T, N, 2 R)
        Of the gradients of the R bands.
    """
    position = np.einsum("nij,tj->tni", geometry.displacement(), attitude_deg)
    if motion is not None:
        position = position + motion.antenna_deg
    d = position[:, :-1]
    products = np.stack([0.5 * d[..., 0] ** 2, d[..., 0] * d[..., 1], 0.5 * d[..., 1] ** 2], axis=-1)
    carriers = d.shape[1]
    downlink = np.zeros((len(d), carriers, geometry.bands, 2))
    downlink[:, np.arange(carriers), geometry.band] = position[:, -1:] - d
    return np.concatenate([d, products], axis=-1), downlink.reshape(len(d), carriers, -1)


def own_prior(carriers: int, daily_size: int) -> FloatArray:
    """Return one sigma of the own coefficients before the data, shape (N, 1 + daily + 2 + 5)."""
    daily = _DISH_PRIOR if daily_size == len(_DISH_PRIOR) else (_HARMONIC_PRIOR_DB,) * daily_size
    return np.tile(np.array([LEVEL_PRIOR_DB, *daily, *(_SOLAR_PRIOR_DB,) * SOLAR_SIZE, *_BEAM_PRIOR]), (carriers, 1))


def is_known_orbit(motion: OrbitMotion | None) -> bool:
    """Return whether ballistics covers any row, so that the dish law can be fitted.

    Examples
    --------
    >>> is_known_orbit(OrbitMotion(np.full((2, 1, 2), np.nan), np.zeros((2, 2, 2))))
    False
    """
    return motion is not None and bool(np.isfinite(motion.sight_deg).all(axis=(1, 2)).any())
