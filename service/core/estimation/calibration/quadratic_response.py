"""Answer of the carriers to the attitude: a quadratic tied to where the stations stand, and how well it is known.

Turning the body moves station i by ``d = D_i l`` in the antenna frame, d = (daz, del) in deg, l = (yaw, roll, pitch) in
deg, ``D_i`` the exact derivative of the rotation at zero attitude (``displacement_matrix``). Its level then changes by

``dP_i = g_i' d + d' H_i d / 2 + g_b' (D_rx - D_i) l``

with the gradient g in dB/deg and Hessian H in dB/deg^2 of all the beams the carrier passes through, taken at its own
station, and ``g_b`` the gradient of the downlink of band b, which is the part that belongs to the receiving site and
moves with it. Collected in l this is ``dP_i = s_i' l + l' M_i l / 2``, the form in which it is used. What the rotation
has beyond its derivative is below 0.002 deg at 0.4 deg, hence below 0.005 dB.

The law of this file: yaw has no coefficient of its own. It moves a station by a known amount, and the beam's slope is
what roll and pitch have measured.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

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
