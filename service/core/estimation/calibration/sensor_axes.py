"""Axes of the attitude sensors and positions of the stations, judged by the powers."""

from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.calibration.geometry_columns import (
    BEAM_SIZE,
    DOWNLINK_PRIOR_DB_PER_DEG,
    CarrierGeometry,
    beam_columns,
    symmetric_matrix,
)
from service.core.estimation.calibration.joint_tukey import JointProblem, SeparableFit, fit_jointly, fit_separable
from service.core.estimation.calibration.whitened_fit import ColouredNoise, stretch_variance_db2, whitened_rows

#: one sigma of slopes (dB/deg) and curvatures (dB/deg^2) before the data, as wide as those of the beams
_PRIOR = (10.0, 10.0, 10.0, 15.0, 15.0, 15.0, 15.0, 15.0, 15.0)


class FreeResponse(NamedTuple):
    """Free answer of N carriers.

    Parameters
    ----------
    slope : ndarray, shape (N, 3), dB/deg
        Columns yaw, roll, pitch as the sensor names them.
    curvature : ndarray, shape (N, 3, 3), dB/deg^2
        Symmetric.
    covariance : ndarray, shape (N, 3, 3), dB^2/deg^2
        Of the slopes, by each carrier's own noise.
    """

    slope: FloatArray
    curvature: FloatArray
    covariance: FloatArray


def fit_free_response(
    problem: JointProblem, monomials: FloatArray, prior: FloatArray, white_db: FloatArray, noise: ColouredNoise
) -> FreeResponse:
    """Return the free answer of all carriers.

    Parameters
    ----------
    problem : JointProblem
        Thinned rows of N carriers in B stretches; its columns of the beams and of the downlink are replaced.
    monomials : ndarray, shape (N, B, 9)
        Means of ``response_monomials``.
    prior : ndarray, shape (N, K)
        One sigma of each own coefficient of ``problem``.
    white_db : ndarray, shape (N,), dB
        Scatter of single rows, for the robust weights.
    noise : ColouredNoise
        Own noise of the carriers, for the whitening.
    """
    size = monomials.shape[2]
    own = np.concatenate([problem.own[..., :-BEAM_SIZE], monomials], axis=2)
    nothing = np.zeros((*problem.value.shape, 0))
    free = problem._replace(own=own, shared=nothing, beam_size=size)
    wide = np.concatenate([prior[:, :-BEAM_SIZE], np.tile(_PRIOR, (len(prior), 1))], axis=1)
    _fit, weight = fit_jointly(free, wide, white_db)
    variance = stretch_variance_db2(noise, free.rows_used, free.span_s)
    stacked = np.concatenate([own, free.value[..., np.newaxis]], axis=2)
    white = whitened_rows(stacked, free.centre_s, variance, noise, weight)
    fit = fit_separable(white[..., :-1], nothing, white[..., -1], wide, 1.0)
    found = fit.own[:, -size:]
    slopes = slice(-size, 3 - size)
    return FreeResponse(found[:, :3], symmetric_matrix(found[:, 3:]), fit.own_covariance[:, slopes, slopes])


#: chi-square of five sigma
DECISIVE = 25.0
#: fewest carriers that a verdict can rest on
MIN_CARRIERS = 5
#: dB/deg, one sigma of the part of the yaw slopes that all carriers share
_COMMON_PRIOR_DB_PER_DEG = 1.0
#: one sigma of a and b before the data, so wide that only beams without any slope feel it
_COEFFICIENT_PRIOR = 1e3
#: (dB/deg)^2, a misfit is not believed to be smaller
_LEAST_VARIANCE = 1e-12
#: a test of one sign counts where its coefficient is 1 or -1 within this factor
_COEFFICIENT_FACTOR = 2.0
#: deg, error of the change that a sensor tells of a turn
_TURN_SIGMA_DEG = 0.03


def _mappings() -> FloatArray:
    """Return all signed permutations (48, 3, 3), the simplest mistakes first."""
    found = [
        np.array(signs)[:, np.newaxis] * np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return np.array(sorted(found, key=lambda one: (np.count_nonzero(np.diag(one) == 0.0), (one < 0.0).sum())))


#: (48, 3, 3): the true angles are ``mapping @ angles of the sensor``; the first is the healthy sensor, the first eight
#: exchange nothing
MAPPINGS = _mappings()
_FLIPS = 8


class AxesVerdict(NamedTuple):
    """Verdict of the powers on the sensor's axes.

    Parameters
    ----------
    coefficient, sigma : ndarray, shape (2,)
        a of ``s_pitch y`` and b of ``-s_roll x`` and one standard deviation of each.
    chi_square : ndarray, shape (48,)
        Of each of ``MAPPINGS``; differences of 25 are five sigma. Without an exchange, other scales are allowed.
    """

    coefficient: FloatArray
    sigma: FloatArray
    chi_square: FloatArray

    def margin(self, *flips: float) -> float:
        """Return by how much chi-square the sensor as it is explains the powers better than one with flipped axes."""
        flipped = (np.diag(np.array(flips)) == MAPPINGS).all(axis=(1, 2))
        return float(self.chi_square[flipped][0] - self.chi_square[0])


def judge_axes(
    free: FreeResponse,
    geometry: CarrierGeometry,
    beam: IntArray,
    is_used: BoolArray,
    turns: tuple[FloatArray, FloatArray],
) -> AxesVerdict | None:
    """Return the verdict on the sensor's axes, None with too few carriers.

    Parameters
    ----------
    free : FreeResponse
        Free answer of N carriers.
    geometry : CarrierGeometry
        Where their stations stand.
    beam : ndarray of int, shape (N,)
        Number of the receive beam of each carrier.
    is_used : ndarray of bool, shape (N,)
        Carriers to judge by: with a station, a free answer and no level control.
    turns : tuple of ndarray, shape (C, 3) each, deg
        Announced corrections and the changes that the sensor told; NaN rows take no part.
    """
    used = np.flatnonzero(is_used)
    if len(used) < MIN_CARRIERS:
        return None
    relation = _relation(geometry, used)
    chi_square, penalty = np.zeros(len(MAPPINGS)), np.zeros(len(MAPPINGS))
    for k, mapping in enumerate(MAPPINGS):
        slope, weight = relation.mapped(free, used, mapping)
        misfit = (relation.row * slope).sum(axis=1)
        chi_square[k] = misfit @ weight @ misfit
        # azimuth changes with pitch and elevation with roll
        curvature = (mapping @ free.curvature[used] @ mapping.T)[:, 1:, 1:][:, ::-1, ::-1]
        beams = _of_beams(relation.gradient(slope), curvature, geometry, beam, used)
        scores = (*beams, *_of_turns(turns[1] @ mapping.T, turns[0]))
        penalty[k] = sum(score**2 for score in scores if score < 0.0 and score**2 > DECISIVE)
    slope, weight = relation.mapped(free, used, MAPPINGS[0])
    parts = relation.gradient(slope) * relation.by_yaw
    covariance = np.linalg.inv(parts.T @ weight @ parts + np.eye(2) / _COEFFICIENT_PRIOR**2)
    coefficient = covariance @ (parts.T @ weight @ slope[:, 0])
    left = slope[:, 0] - parts @ coefficient
    scaled = float(left @ weight @ left)
    # what neither scales nor any mapping explains is noise that the carriers' own model does not know
    growth = max(1.0, min(scaled, float(chi_square.min())) / (len(used) - 2))
    flips = np.diagonal(MAPPINGS[:_FLIPS], axis1=1, axis2=2)
    chi_square[:_FLIPS][(flips[:, :1] * flips[:, :0:-1] == np.sign(coefficient)).all(axis=1)] = scaled
    return AxesVerdict(coefficient, np.sqrt(np.diag(covariance) * growth), chi_square / growth + penalty)


class _Relation(NamedTuple):
    """Relation between the slopes of U carriers, ``row @ slope = nuisance @ unknowns``."""

    #: (U, 2, 2) gradients from the slopes of roll and pitch; (U, 2) deg of azimuth and elevation per deg of yaw
    inverse: FloatArray
    by_yaw: FloatArray
    #: (U, 3) and (U, 1 + 2 R)
    row: FloatArray
    nuisance: FloatArray

    def gradient(self, slope: FloatArray) -> FloatArray:
        """Return the gradients (U, 2) that roll and pitch tell, dB/deg."""
        return np.asarray(np.einsum("njk,nk->nj", self.inverse, slope[:, 1:]))

    def mapped(self, free: FreeResponse, used: IntArray, mapping: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return slopes (U, 3) about the mapped axes and the weight (U, U) of their misfits."""
        row = self.row @ mapping
        variance = np.maximum(np.einsum("ni,nij,nj->n", row, free.covariance[used], row), _LEAST_VARIANCE)
        weight = np.linalg.inv(np.diag(variance) + self.nuisance @ self.nuisance.T)
        return np.asarray(free.slope[used] @ mapping.T), np.asarray(weight, dtype=np.float64)


def _relation(geometry: CarrierGeometry, used: IntArray) -> _Relation:
    position = geometry.displacement()
    by_yaw, count = position[used, :, 0], np.arange(len(used))
    nuisance = np.zeros((len(used), 1 + 2 * geometry.bands))
    nuisance[:, 0] = _COMMON_PRIOR_DB_PER_DEG
    for axis in range(2):
        moved = position[-1, axis, 0] - by_yaw[:, axis]
        nuisance[count, 1 + 2 * geometry.band[used] + axis] = DOWNLINK_PRIOR_DB_PER_DEG * moved
    inverse = np.linalg.inv(np.swapaxes(position[used][:, :, 1:], 1, 2))
    row = np.concatenate([np.ones((len(used), 1)), -np.einsum("nj,njk->nk", by_yaw, inverse)], axis=1)
    return _Relation(np.asarray(inverse, dtype=np.float64), by_yaw, row, nuisance)


def _of_beams(
    gradient: FloatArray, curvature: FloatArray, geometry: CarrierGeometry, beam: IntArray, used: IntArray
) -> tuple[float, float]:
    """Return the scores of pitch and roll by the gradients (U, 2) of the stations of each beam."""
    position = np.column_stack([geometry.azimuth_deg, geometry.elevation_deg])[used]
    expected, found = np.zeros_like(gradient), np.zeros_like(gradient)
    beams = np.unique(beam[used])
    for one in beams:
        members = beam[used] == one
        apart = position[members] - position[members].mean(axis=0)
        expected[members] = apart @ curvature[members].mean(axis=0)
        found[members] = gradient[members] - gradient[members].mean(axis=0)
    free = len(used) - len(beams) - 1
    return _score(expected[:, 0], found[:, 0], free), _score(expected[:, 1], found[:, 1], free)


def _of_turns(reported_deg: FloatArray, announced_deg: FloatArray) -> tuple[float, ...]:
    """Return the scores of yaw, roll and pitch by the changes (C, 3) that sensor and announcement tell."""
    known = np.isfinite(reported_deg).all(axis=1) & np.isfinite(announced_deg).all(axis=1)
    reported, announced = reported_deg[known], announced_deg[known]
    return tuple(_score(announced[:, k], reported[:, k], len(reported) - 1, _TURN_SIGMA_DEG) for k in range(3))


def _score(expected: FloatArray, found: FloatArray, free: int, least_sigma: float = 0.0) -> float:
    """Return the coefficient of ``found`` on ``expected`` in sigmas of its scatter, 0 where it is far from 1 or -1."""
    size = float(expected @ expected)
    if free < 1 or size == 0.0:
        return 0.0
    coefficient = float(expected @ found) / size
    if not 1.0 / _COEFFICIENT_FACTOR <= abs(coefficient) <= _COEFFICIENT_FACTOR:
        return 0.0
    left = found - coefficient * expected
    sigma = max(float(np.sqrt(left @ left / free)), least_sigma, 1e-12)
    return coefficient * float(np.sqrt(size)) / sigma


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
