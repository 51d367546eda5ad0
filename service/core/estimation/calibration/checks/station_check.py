"""Check of station positions: offsets from the catalogue that the data suggest.

Yaw has no coefficient of its own: it moves a station by an amount that follows from its position in the antenna frame.
A wrong position therefore leaves a pattern in the residuals of the turns, the derivative of the model with respect to
the position, and a fit of two more coefficients for each carrier, azimuth and elevation of its station, finds it. The
law of this file: a carrier is judged by the downlink of the others, because with its own it would hide its error by
bending it. A flat carrier gives no information and has a large covariance.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.calibration.coloured_rows import ColouredNoise, stretch_variance_db2, whitened_rows
from service.core.estimation.calibration.geometry_columns import (
    BEAM_SIZE,
    DOWNLINK_PRIOR_DB_PER_DEG,
    CarrierGeometry,
    beam_columns,
)
from service.core.estimation.calibration.joint_tukey import JointProblem
from service.core.estimation.calibration.separable_fit import SeparableFit, fit_separable

FloatArray = NDArray[np.float64]

#: deg, half the step of the derivative
_STEP_DEG = 0.25
#: deg, one sigma of a place before the data: the whole Earth is 17 deg wide
_PRIOR_DEG = 10.0
#: misfits beyond so many sigmas count as if they were that large, beyond so many dB not at all
_HELD_SIGMAS = 4.0
_WORST_DB = 2.0


class StationOffsets(NamedTuple):
    """Offsets of N stations from the catalogue, in the antenna frame.

    Parameters
    ----------
    offset_deg : ndarray, shape (N, 2), deg
        Azimuth and elevation.
    covariance_deg2 : ndarray, shape (N, 2, 2), deg^2
        Of the offsets.
    """

    offset_deg: FloatArray
    covariance_deg2: FloatArray

    @property
    def chi_square(self) -> FloatArray:
        """Squares of the offsets over their covariance, (N,); 2 on average for stations in their places."""
        scaled = np.linalg.solve(self.covariance_deg2, self.offset_deg[..., np.newaxis])[..., 0]
        return np.asarray((self.offset_deg * scaled).sum(axis=1))


def station_offsets(
    problem: JointProblem,
    attitude_deg: FloatArray,
    geometry: CarrierGeometry,
    fitted: tuple[SeparableFit, FloatArray],
    noise: ColouredNoise,
) -> StationOffsets:
    """Return where the data want the stations.

    Parameters
    ----------
    problem : JointProblem
        Thinned rows of N carriers in B stretches.
    attitude_deg : ndarray, shape (B, 3), deg
        Mean attitude of the stretches.
    geometry : CarrierGeometry
        Where the catalogue has the stations.
    fitted : tuple
        The fit with the catalogue's places and the prior (N, K) that it used.
    noise : ColouredNoise
        Of the rows.

    Returns
    -------
    StationOffsets
    """
    fit, prior = fitted
    variance = stretch_variance_db2(noise, problem.rows_used, problem.span_s)
    misfit = problem.value - np.einsum("nbk,nk->nb", problem.own, fit.own) - problem.shared @ fit.shared
    # the fit's own weights have thrown out the very rows that contradict a wrong place: here they are only held down
    size = np.maximum(np.abs(misfit), 1e-9)
    weight = np.where(size < _WORST_DB, np.minimum(_HELD_SIGMAS * np.sqrt(variance) / size, 1.0), 0.0)
    weight = np.where(problem.rows_used > 0, weight, 0.0)

    def whitened(*columns: FloatArray) -> FloatArray:
        return whitened_rows(np.concatenate(columns, axis=2), problem.centre_s, variance, noise, weight)

    value = problem.value[..., np.newaxis]
    own, shared, shared_sigma = _reported_by_others(whitened(problem.own, problem.shared, value), prior)
    slopes = np.stack([_derivative(attitude_deg, geometry, own, shared, axis) for axis in range(2)], axis=-1)
    model = np.einsum("nbk,nk->nb", problem.own, own) + np.einsum("nbr,nr->nb", problem.shared, shared)
    white = whitened(problem.own, problem.shared, slopes, value - model[..., np.newaxis])
    positions = np.full((len(prior), 2), _PRIOR_DEG)
    # the downlink may move by what the others leave open
    open_prior = np.concatenate([prior, shared_sigma, positions], axis=1)
    nothing = np.zeros((*misfit.shape, 1))
    found = fit_separable(white[..., :-1], nothing, white[..., -1], open_prior, 1.0)
    return StationOffsets(found.own[:, -2:], found.own_covariance[:, -2:, -2:])


def _reported_by_others(white: FloatArray, prior: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return each carrier's own coefficients (N, K) under the downlink (N, R) that the others tell, and its sigmas."""
    count, own_size = prior.shape
    shared_size = white.shape[2] - own_size - 1
    prior_rows = np.zeros((count, own_size, white.shape[2]))
    prior_rows[:, np.arange(own_size), np.arange(own_size)] = 1.0 / np.maximum(prior, 1e-9)
    triangle: FloatArray = np.asarray(np.linalg.qr(np.concatenate([white, prior_rows], axis=1), mode="r"))
    below = triangle[:, own_size:, own_size:]
    normal = np.swapaxes(below[..., :-1], 1, 2) @ below
    others = normal.sum(axis=0) - normal
    inverse = np.linalg.inv(others[..., :-1] + np.eye(shared_size) / DOWNLINK_PRIOR_DB_PER_DEG**2)
    shared = (inverse @ others[..., -1:])[..., 0]
    right = triangle[:, :own_size, -1] - np.einsum("nkr,nr->nk", triangle[:, :own_size, own_size:-1], shared)
    own = np.linalg.solve(triangle[:, :own_size, :own_size], right[..., np.newaxis])[..., 0]
    return own, shared, np.sqrt(np.diagonal(inverse, axis1=1, axis2=2))


def _derivative(
    attitude_deg: FloatArray, geometry: CarrierGeometry, own: FloatArray, shared: FloatArray, axis: int
) -> FloatArray:
    """Return the change (N, B) of the model by a degree of a station's place, dB/deg."""
    name = ("azimuth_deg", "elevation_deg")[axis]
    levels = []
    for step_deg in (_STEP_DEG, -_STEP_DEG):
        moved = geometry._replace(**{name: getattr(geometry, name) + step_deg})
        beam, downlink = beam_columns(attitude_deg, moved, None)
        levels.append((beam * own[:, -BEAM_SIZE:]).sum(axis=-1) + (downlink * shared).sum(axis=-1))
    return np.asarray((levels[0] - levels[1]).T / (2.0 * _STEP_DEG))
