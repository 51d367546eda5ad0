"""Signs, scales and names of the attitude sensor's axes, judged by the powers.

Yaw moves station i East by ``-yaw y`` and North by ``yaw x`` (x, y: its azimuth and elevation in rad), pitch moves it
West and roll South. The slopes in dB/deg of one carrier are therefore bound to each other,

``s_yaw = a s_pitch y + b (-s_roll) x + c + g_b' (D_rx - D_i)_yaw``,   a = b = 1,

with the downlink gradient g_b of its band and a common part c as nuisances. A sensor that flips yaw makes a = b = -1,
as one that flips roll and pitch does; flipped roll (or yaw and pitch) makes b = -1, flipped pitch (or yaw and roll)
a = -1. Exchanged axes fit no pair of coefficients. All 48 ways in which three axes can be exchanged and flipped are
tried as a correction of the sensor. The relation is the same when all three are flipped. Two more tests know the
sign of one axis by itself:

* gradients of stations of one beam: over the beam they change by its curvature, which has no sign of the sensor,
* announced corrections of the turns: the sensor must turn as announced.

The law of this file: a test that has no clear outcome says nothing, for or against.
"""

from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.calibration.checks.free_response import FreeResponse
from service.core.estimation.calibration.geometry_columns import DOWNLINK_PRIOR_DB_PER_DEG, CarrierGeometry

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

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
    """Return the relation of some carriers."""
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
