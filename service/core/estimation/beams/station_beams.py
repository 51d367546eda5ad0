"""Beams as a calibration measured them: gradient and curvature at each station, changes, and the shape between.

The gradient is that of the level by a turn of the body: of the uplink beam at the station, and of the downlink at the
receiving site, which all carriers of a band share and which only turns about yaw tell apart.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.calibration.geometry_calibration import GeometryCalibration
from service.core.estimation.calibration.geometry_columns import BEAM_SIZE

FloatArray = NDArray[np.float64]

#: powers of East and North of a surface of degree three without its constant
_POWERS = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
#: dB/deg^k, one sigma of a coefficient of degree k before the data
_PRIOR = np.array([10.0, 10.0, 3.0, 3.0, 3.0, 0.5, 0.5, 0.5, 0.5])


class StationBeams(NamedTuple):
    """Beams at N stations, East and North in the antenna frame.

    Parameters
    ----------
    gradient_db_deg, gradient_sigma : ndarray, shape (N, 2), dB/deg
    covariance : ndarray, shape (N, 2, 2), dB^2/deg^2
        Of the gradients.
    curvature_db_deg2, curvature_sigma : ndarray, shape (N, 3), dB/deg^2
        East East, East North, North North.
    """

    gradient_db_deg: FloatArray
    gradient_sigma: FloatArray
    covariance: FloatArray
    curvature_db_deg2: FloatArray
    curvature_sigma: FloatArray


def station_beams(calibration: GeometryCalibration) -> StationBeams:
    """Return the beams of a calibration at its N stations; NaN where it has no coefficients."""
    size = calibration.covariance.shape[1]
    gradient, curvature = slice(size - BEAM_SIZE, size - BEAM_SIZE + 2), slice(size - BEAM_SIZE + 2, size)
    sigma = np.sqrt(np.maximum(np.diagonal(calibration.covariance, axis1=1, axis2=2), 0.0))
    return StationBeams(
        calibration.gradient,
        sigma[:, gradient],
        calibration.covariance[:, gradient, gradient],
        calibration.hessian,
        sigma[:, curvature],
    )


def changes_in_sigmas(now: StationBeams, before: StationBeams) -> FloatArray:
    """Return by how many sigmas (N,) each gradient differs from that of another calibration.

    The square is chi square of two degrees of freedom where nothing changed; 3.0 is exceeded by one in ninety.

    Examples
    --------
    >>> beam = StationBeams(np.zeros((1, 2)), np.ones((1, 2)), np.eye(2)[None], np.zeros((1, 3)), np.ones((1, 3)))
    >>> changes_in_sigmas(beam, beam._replace(gradient_db_deg=np.array([[2.0, 0.0]]))).round(3)
    array([1.414])
    """
    difference = now.gradient_db_deg - before.gradient_db_deg
    covariance = now.covariance + before.covariance
    is_known = np.asarray(np.isfinite(difference).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2)))
    safe = np.where(is_known[:, None, None], covariance, np.eye(2))
    square = np.einsum("ni,nij,nj->n", difference, np.linalg.inv(safe), difference)
    return np.where(is_known, np.sqrt(np.maximum(square, 0.0)), np.nan)


def beam_surface(position_deg: FloatArray, beams: StationBeams) -> FloatArray:
    """Return the surface of degree three that fits gradients and curvatures of the stations of one beam.

    Parameters
    ----------
    position_deg : ndarray, shape (N, 2), deg
        East and North of the stations in the antenna frame.
    beams : StationBeams
        Of the same stations.

    Returns
    -------
    ndarray, shape (9,), dB/deg^k
        Coefficients for ``surface_db``.
    """
    slope, bend = _derivatives(position_deg)
    rows = np.concatenate([slope.reshape(-1, len(_POWERS)), bend.reshape(-1, len(_POWERS))])
    value = np.concatenate([beams.gradient_db_deg.ravel(), beams.curvature_db_deg2.ravel()])
    sigma = np.concatenate([beams.gradient_sigma.ravel(), beams.curvature_sigma.ravel()])
    is_known = np.isfinite(value) & np.isfinite(sigma) & (sigma > 0.0)
    scaled = rows[is_known] / sigma[is_known, None]
    system = np.concatenate([scaled, np.diag(1.0 / _PRIOR)])
    right = np.concatenate([value[is_known] / sigma[is_known], np.zeros(len(_POWERS))])
    return np.asarray(np.linalg.lstsq(system, right, rcond=None)[0])


def surface_db(position_deg: FloatArray, surface: FloatArray) -> FloatArray:
    """Return the gain (...) in dB of a surface at places (..., 2), relative to that at nadir.

    Examples
    --------
    >>> surface_db(np.array([2.0, 1.0]), np.array([1.0, 0, 0, 0, 0, 0, 0, 0, 1.0]))
    np.float64(3.0)
    """
    east, north = position_deg[..., 0], position_deg[..., 1]
    return np.asarray(np.stack([east**i * north**j for i, j in _POWERS], axis=-1) @ surface)[()]


def _derivatives(position_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return columns of gradients (N, 2, 9) and of curvatures (N, 3, 9) of the surface."""
    east, north = position_deg[:, 0], position_deg[:, 1]

    def term(i: int, j: int, along: int, across: int) -> FloatArray:
        factor = float(np.prod(range(i - along + 1, i + 1)) * np.prod(range(j - across + 1, j + 1)))
        if along > i or across > j:
            return np.zeros(len(east))
        return np.asarray(factor * east ** (i - along) * north ** (j - across))

    def columns(orders: tuple[tuple[int, int], ...]) -> FloatArray:
        return np.stack([np.stack([term(i, j, *order) for i, j in _POWERS], axis=-1) for order in orders], axis=1)

    return columns(((1, 0), (0, 1))), columns(((2, 0), (1, 1), (0, 2)))
