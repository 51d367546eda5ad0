"""Columns of the joint calibration: level, daily change, beams, downlink, and the quadratic answer to the attitude."""

from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray, IntArray

#: Pairs of axes of the six monomials of second degree.
_FIRST, _SECOND = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])


class QuadraticResponse(NamedTuple):
    """Answer of N carriers; NaN for a carrier that is not known.

    Parameters
    ----------
    slope : ndarray, shape (N, 3), dB/deg
        s, columns yaw, roll, pitch.
    curvature : ndarray, shape (N, 3, 3), dB/deg^2
        M, symmetric.
    covariance : ndarray, shape (N, 9, 9), dB^2/deg^2 to deg^4
        Of the three slopes and the coefficients M00, M11, M22, M01, M02, M12 of each carrier.
    common_root : ndarray, shape (N, 9, R)
        The part of the errors that carriers share: ``common_root[i] @ common_root[j].T`` is the covariance between
        the coefficients of carriers i and j, and contained in ``covariance`` for i = j.
    """

    slope: FloatArray
    curvature: FloatArray
    covariance: FloatArray
    common_root: FloatArray


def exact_response(slope: FloatArray, curvature: FloatArray) -> QuadraticResponse:
    """Return the response of coefficients that are known without error.

    Examples
    --------
    >>> exact_response(np.zeros((4, 3)), np.zeros((4, 3, 3))).covariance.shape
    (4, 9, 9)
    """
    count = len(slope)
    return QuadraticResponse(slope, curvature, np.zeros((count, 9, 9)), np.zeros((count, 9, 1)))


def displacement_matrix(azimuth_deg: FloatArray, elevation_deg: FloatArray) -> FloatArray:
    """Return how the stations move in the antenna frame with the attitude.

    Parameters
    ----------
    azimuth_deg, elevation_deg : ndarray, shape (N,), deg
        Antenna angles at zero attitude, ``service.core.geometry.frames``.

    Returns
    -------
    ndarray, shape (N, 2, 3)
        D, deg of azimuth and elevation per deg of yaw, roll, pitch.

    Notes
    -----
    ``daz = -pitch - (yaw te + roll ta te) cos^2 az``, ``del = -roll + (yaw ta - pitch ta te) cos^2 el`` with
    ta = tan az, te = tan el: the first derivative of the exact rotation. Without the tangents 1 % of yaw is lost.

    Examples
    --------
    >>> displacement_matrix(np.zeros(1), np.zeros(1))
    array([[[-0., -0., -1.],
            [ 0., -1., -0.]]])
    """
    ta, te = np.tan(np.radians(azimuth_deg)), np.tan(np.radians(elevation_deg))
    ca, ce = np.cos(np.radians(azimuth_deg)) ** 2, np.cos(np.radians(elevation_deg)) ** 2
    one = np.ones_like(ta)
    azimuth_row = np.stack([-te * ca, -ta * te * ca, -one], axis=-1)
    elevation_row = np.stack([ta * ce, -one, -ta * te * ce], axis=-1)
    return np.stack([azimuth_row, elevation_row], axis=-2)


def predict_deviation(attitude_deg: FloatArray, model: QuadraticResponse) -> FloatArray:
    """Return the change of level of every carrier against zero attitude.

    Parameters
    ----------
    attitude_deg : ndarray, shape (..., 3), deg
        Yaw, roll, pitch.
    model : QuadraticResponse
        N carriers.

    Returns
    -------
    ndarray, shape (..., N), dB

    Examples
    --------
    >>> model = exact_response(np.array([[0.1, 1.0, 2.0]]), -2.0 * np.eye(3)[np.newaxis])
    >>> predict_deviation(np.array([0.0, 0.1, 0.2]), model).round(9)
    array([0.45])
    """
    half = 0.5 * predict_jacobian(attitude_deg, model, slope_weight=2.0)
    return np.asarray((half @ attitude_deg[..., np.newaxis])[..., 0])


def predict_jacobian(attitude_deg: FloatArray, model: QuadraticResponse, *, slope_weight: float = 1.0) -> FloatArray:
    """Return the derivative of the prediction, shape (..., N, 3), dB/deg, at attitudes of shape (..., 3).

    ``slope_weight`` multiplies the constant part; it is 1 in the derivative.

    Examples
    --------
    >>> model = exact_response(np.array([[0.1, 1.0, 2.0]]), -2.0 * np.eye(3)[np.newaxis])
    >>> predict_jacobian(np.array([0.0, 0.1, 0.2]), model).round(9)
    array([[0.1, 0.8, 1.6]])
    """
    count = len(model.slope)
    bent = attitude_deg @ model.curvature.transpose(1, 0, 2).reshape(3, 3 * count)
    return np.asarray(bent.reshape(*attitude_deg.shape[:-1], count, 3) + slope_weight * model.slope)


def response_monomials(attitude_deg: FloatArray) -> FloatArray:
    """Return the nine factors (..., 9) of slopes and curvature coefficients in the prediction.

    Examples
    --------
    >>> response_monomials(np.array([1.0, 2.0, 3.0]))
    array([1. , 2. , 3. , 0.5, 2. , 4.5, 2. , 3. , 6. ])
    """
    squares = attitude_deg[..., _FIRST] * attitude_deg[..., _SECOND]
    return np.concatenate([attitude_deg, squares * np.where(_FIRST == _SECOND, 0.5, 1.0)], axis=-1)


def response_errors(attitude_deg: FloatArray, model: QuadraticResponse) -> tuple[FloatArray, FloatArray]:
    """Return how far the prediction may be off because the calibration is.

    Parameters
    ----------
    attitude_deg : ndarray, shape (..., 3), deg
        Yaw, roll, pitch.
    model : QuadraticResponse
        N carriers.

    Returns
    -------
    variance_db2 : ndarray, shape (..., N), dB^2
        Of each carrier's prediction, common part included.
    common_db : ndarray, shape (..., N, R), dB
        Root of the part that carriers share: their covariance is ``common_db @ common_db.T``.

    Examples
    --------
    >>> variance_db2, _ = response_errors(np.zeros(3), exact_response(np.zeros((2, 3)), np.zeros((2, 3, 3))))
    >>> variance_db2
    array([0., 0.])
    """
    factors = response_monomials(attitude_deg)
    products = (factors[..., :, np.newaxis] * factors[..., np.newaxis, :]).reshape(*factors.shape[:-1], 81)
    variance = products @ model.covariance.reshape(-1, 81).T
    common = np.einsum("...k,nkr->...nr", factors, model.common_root)
    return np.maximum(variance, 0.0), common


def response_transform(displacement: FloatArray, site_displacement: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the linear maps from beam coefficients to the nine of the response.

    Parameters
    ----------
    displacement : ndarray, shape (N, 2, 3)
        D of the stations.
    site_displacement : ndarray, shape (2, 3)
        D of the receiving site.

    Returns
    -------
    own : ndarray, shape (N, 9, 5)
        From (g_az, g_el, H_az_az, H_az_el, H_el_el).
    downlink : ndarray, shape (N, 9, 2)
        From the downlink gradient of the carrier's band.
    """
    count = len(displacement)
    own, downlink = np.zeros((count, 9, 5)), np.zeros((count, 9, 2))
    own[:, :3, :2] = displacement.transpose(0, 2, 1)
    downlink[:, :3] = (site_displacement - displacement).transpose(0, 2, 1)
    az, el = displacement[:, 0], displacement[:, 1]
    for column, (left, right) in enumerate([(az, az), (az, el), (el, el)]):
        twice = left[:, _FIRST] * right[:, _SECOND] + right[:, _FIRST] * left[:, _SECOND]
        own[:, 3:, 2 + column] = twice if column == 1 else 0.5 * twice
    return own, downlink


def symmetric_matrix(coefficients: FloatArray) -> FloatArray:
    """Return matrices (..., 3, 3) of the six coefficients 00, 11, 22, 01, 02, 12.

    Examples
    --------
    >>> symmetric_matrix(np.arange(6.0))
    array([[0., 3., 4.],
           [3., 1., 5.],
           [4., 5., 2.]])
    """
    return np.asarray(coefficients[..., np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])])


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
