"""Whether the data want a station elsewhere than the catalogue has it.

Yaw has no coefficient of its own: it moves a station by an amount that its place in the antenna frame tells. A wrong
place therefore leaves a pattern in the residuals of the turns, the derivative of the model with respect to the place,
and a fit of two more coefficients for each carrier, azimuth and elevation of its station, reads it. The law of this
file: a place is told by the slope and the curvature of the carrier's own beam, so a flat carrier tells nothing and says
so by its covariance; blunders of many degrees are found, not errors of a few.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.calibration.coloured_rows import ColouredNoise, stretch_variance_db2, whitened_rows
from service.core.estimation.calibration.geometry_columns import BEAM_SIZE, CarrierGeometry, beam_columns
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
    """Where N stations should stand against the catalogue, in the antenna frame.

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
    slopes = np.stack([_derivative(attitude_deg, geometry, fit, axis) for axis in range(2)], axis=-1)
    misfit = problem.value - np.einsum("nbk,nk->nb", problem.own, fit.own) - problem.shared @ fit.shared
    stacked = np.concatenate([problem.own, slopes, misfit[..., np.newaxis]], axis=2)
    variance = stretch_variance_db2(noise, problem.rows_used, problem.span_s)
    # the fit's own weights have thrown out the very rows that contradict a wrong place: here they are only held down
    size = np.maximum(np.abs(misfit), 1e-9)
    weight = np.where(size < _WORST_DB, np.minimum(_HELD_SIGMAS * np.sqrt(variance) / size, 1.0), 0.0)
    white = whitened_rows(stacked, problem.centre_s, variance, noise, np.where(problem.rows_used > 0, weight, 0.0))
    nothing = np.zeros((*misfit.shape, 1))
    places = np.full((len(prior), 2), _PRIOR_DEG)
    found = fit_separable(white[..., :-1], nothing, white[..., -1], np.concatenate([prior, places], axis=1), 1.0)
    return StationOffsets(found.own[:, -2:], found.own_covariance[:, -2:, -2:])


def _derivative(attitude_deg: FloatArray, geometry: CarrierGeometry, fit: SeparableFit, axis: int) -> FloatArray:
    """Return the change (N, B) of the model by a degree of a station's place, dB/deg."""
    name = ("azimuth_deg", "elevation_deg")[axis]
    levels = []
    for step_deg in (_STEP_DEG, -_STEP_DEG):
        moved = geometry._replace(**{name: getattr(geometry, name) + step_deg})
        own, downlink = beam_columns(attitude_deg, moved, None)
        levels.append((own * fit.own[:, -BEAM_SIZE:]).sum(axis=-1) + downlink @ fit.shared)
    return np.asarray((levels[0] - levels[1]).T / (2.0 * _STEP_DEG))
