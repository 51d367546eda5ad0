"""Sign check: turns that prove the sign of each axis, and their direction by the powers alone."""

from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray
from service.core.estimation.filtering.filter_model import CarrierModel, pattern_change

#: log-likelihood ratio against each of the two others that decides
DECISIVE = 9.0
#: mean square of the whitened residual of the best hypothesis above which none of them explains the powers; with a few
#: hundred values its own scatter is below 0.1
_CONTRADICTED = 1.6
#: values from which that mean is looked at
_ENOUGH_VALUES = 100
#: levels of carriers and of all are free within this, dB
_FREE_DB = 3.0


class Sign(Enum):
    """Response of a spacecraft to a command."""

    PLUS = 1
    NOTHING = 0
    MINUS = -1


class SignState(Enum):
    """State of the sign check of a command, from the powers so far."""

    PLUS = "plus"
    MINUS = "minus"
    NOTHING = "nothing"
    #: no hypothesis is likelier than both others by the decisive ratio
    OPEN = "open"
    #: no hypothesis explains the powers
    CONTRADICTED = "contradicted"


class SignContext(NamedTuple):
    """Causes of level changes other than the command; triples in the order yaw, roll, pitch."""

    #: (3,) deg, attitude before the check
    attitude_deg: FloatArray
    #: (3,) deg/h, one standard deviation of a steady drift; roll holds what an unknown yaw adds
    drift_deg_h: tuple[float, float, float] = (0.05, 0.04, 0.035)
    #: random walk of the level of all carriers, dB per square root of hour
    chain_walk_db: float = 0.03


class SignLikelihoods(NamedTuple):
    """Log-likelihoods after each row."""

    #: (T, 3) of PLUS, NOTHING, MINUS, without the part that all share
    log_likelihood: FloatArray
    #: (T,) mean square of the whitened residuals of the best one so far
    fit: FloatArray
    #: (T,) values seen so far
    values: NDArray[np.int64]

    def ratio(self, sign: Sign) -> FloatArray:
        """Return the log-likelihood ratio (T,) of a hypothesis against the better of the others."""
        own = _SIGNS.index(sign)
        others = np.delete(self.log_likelihood, own, axis=1).max(axis=1)
        return np.asarray(self.log_likelihood[:, own] - others)


class SignDecision(NamedTuple):
    """Verdict and the row that settled it."""

    verdict: SignState
    #: place of the row; the last one while open
    row: int
    #: of PLUS, NOTHING, MINUS at that row, against the best
    log_ratio: tuple[float, float, float]


_SIGNS = (Sign.PLUS, Sign.NOTHING, Sign.MINUS)


def weigh(
    model: CarrierModel,
    epochs_s: FloatArray,
    deviation_db: FloatArray,
    profile_deg: FloatArray,
    context: SignContext,
) -> SignLikelihoods:
    """Return how likely each hypothesis is after each row.

    Parameters
    ----------
    model : CarrierModel
        Gradients, Hessians and noise of N carriers.
    epochs_s : ndarray, shape (T,), s
        From the beginning of the check, increasing.
    deviation_db : ndarray, shape (T, N), dB
        Power less reference less daily change, NaN = absent. Levels may be off by anything below a few dB.
    profile_deg : ndarray, shape (T, 3), deg
        Turn that the commands should have made: yaw, roll, pitch.
    context : SignContext
        Attitude before the command, drift, receiving chain.

    Raises
    ------
    ValueError
        Shapes do not fit, epochs do not increase, or a number that must be finite is not.

    Notes
    -----
    One Cholesky factor of T N values: 45 rows of 16 carriers 20 ms, 180 rows 0.5 s.
    """
    _require_rows(model, epochs_s, deviation_db, profile_deg)
    is_there = np.isfinite(deviation_db)
    signatures = [_signature(model, context.attitude_deg, sign.value * profile_deg) for sign in _SIGNS]
    residuals = np.stack([np.where(is_there, deviation_db, 0.0) - each for each in signatures], axis=-1)
    white = _whitened(_covariance(model, epochs_s, context, is_there), residuals[is_there])
    squares = np.zeros((*is_there.shape, 3))
    squares[is_there] = white**2
    sums = squares.sum(axis=1).cumsum(axis=0)
    values = is_there.sum(axis=1).cumsum()
    return SignLikelihoods(-0.5 * sums, sums.min(axis=1) / np.maximum(values, 1), values.astype(np.int64))


def decide(evidence: SignLikelihoods, least_ratio: float = DECISIVE) -> SignDecision:
    """Return the verdict at the first row that settles it.

    A decision against powers that no hypothesis explains is none: `CONTRADICTED` stands above every ratio.
    """
    is_contradicted = (evidence.fit > _CONTRADICTED) & (evidence.values >= _ENOUGH_VALUES)
    ratios = np.stack([evidence.ratio(sign) for sign in _SIGNS], axis=1)
    is_settled = is_contradicted | (ratios >= least_ratio).any(axis=1)
    row = int(np.argmax(is_settled)) if is_settled.any() else len(is_settled) - 1
    log_ratio = evidence.log_likelihood[row] - evidence.log_likelihood[row].max()
    plus, nothing, minus = log_ratio.tolist()
    if is_contradicted[row]:
        verdict = SignState.CONTRADICTED
    elif is_settled[row]:
        verdict = SignState[_SIGNS[int(np.argmax(ratios[row]))].name]
    else:
        verdict = SignState.OPEN
    return SignDecision(verdict, row, (plus, nothing, minus))


def wheel_decision(
    predicted_n_m_s: FloatArray, measured_n_m_s: FloatArray, sigma_n_m_s: float, least_ratio: float = DECISIVE
) -> SignDecision:
    """Return the verdict of the wheels' telemetry: whether their momentum changed as commanded.

    Parameters
    ----------
    predicted_n_m_s, measured_n_m_s : ndarray, shape (W,), N m s
        Change of each wheel's momentum over a command; NaN in the measured one = not told.
    sigma_n_m_s : float, N m s
        Error of a measured change, one standard deviation, > 0.

    Raises
    ------
    ValueError
        The shapes differ or sigma is not positive.
    """
    predicted, measured = np.asarray(predicted_n_m_s), np.asarray(measured_n_m_s)
    if predicted.shape != measured.shape or not sigma_n_m_s > 0.0:
        raise ValueError("predicted and measured momentum must be of the same wheels, sigma positive")
    is_told = np.isfinite(measured)
    off = [(measured - sign.value * predicted)[is_told] / sigma_n_m_s for sign in _SIGNS]
    likelihood = np.array([[-0.5 * float(each @ each) for each in off]])
    return decide(SignLikelihoods(likelihood, np.zeros(1), np.array([int(is_told.sum())], dtype=np.int64)), least_ratio)


def _signature(model: CarrierModel, attitude_deg: FloatArray, turn_deg: FloatArray) -> FloatArray:
    """Return the change of the levels (T, N) by turns (T, 3) from an attitude, dB."""
    before = pattern_change(model, attitude_deg).deviation_db
    return np.array([pattern_change(model, attitude_deg + turn).deviation_db - before for turn in turn_deg])


def _covariance(
    model: CarrierModel, epochs_s: FloatArray, context: SignContext, is_there: NDArray[np.bool_]
) -> FloatArray:
    """Return the covariance of the present values, row by row, dB^2."""
    rows, carriers = np.nonzero(is_there)
    apart_s = np.abs(epochs_s[:, None] - epochs_s[None, :])
    hours = epochs_s / 3600.0
    both = np.minimum(hours[:, None], hours[None, :])
    drift = hours[:, None] * hours[None, :]
    shared = _FREE_DB**2 + context.chain_walk_db**2 * both
    for sigma_db, tau_s in zip(model.common_sigma_db.tolist(), model.common_tau_s.tolist(), strict=True):
        shared = shared + sigma_db**2 * np.exp(-apart_s / tau_s)
    gradient = pattern_change(model, context.attitude_deg).gradient_db_deg
    turned = (gradient * np.square(context.drift_deg_h)) @ gradient.T
    total = shared[np.ix_(rows, rows)] + drift[np.ix_(rows, rows)] * turned[np.ix_(carriers, carriers)]
    for k in range(model.carriers):
        own = np.flatnonzero(carriers == k)
        apart = apart_s[np.ix_(rows[own], rows[own])]
        kept = np.full(apart.shape, _FREE_DB**2)
        kept += model.reference_walk_db[k] ** 2 * both[np.ix_(rows[own], rows[own])]
        for sigma_db, tau_s in zip(model.coloured_sigma_db[k], model.coloured_tau_s[k], strict=True):
            kept += sigma_db**2 * np.exp(-apart / tau_s)
        kept[np.diag_indices(len(own))] += model.white_sigma_db[k] ** 2
        total[np.ix_(own, own)] += kept
    return np.asarray(total)


def _whitened(covariance: FloatArray, columns: FloatArray) -> FloatArray:
    """Return columns whose covariance is this one, as columns of unit covariance; rows keep their order."""
    # half a second of import that few runs need
    from scipy.linalg import solve_triangular

    factor = np.linalg.cholesky(covariance)
    return np.asarray(solve_triangular(factor, columns, lower=True, check_finite=False), dtype=np.float64)


def _require_rows(model: CarrierModel, epochs_s: FloatArray, deviation_db: FloatArray, profile_deg: FloatArray) -> None:
    """Refuse rows whose shapes do not fit."""
    rows = len(epochs_s)
    if deviation_db.shape != (rows, model.carriers) or profile_deg.shape != (rows, 3):
        raise ValueError(f"{rows} epochs need as many rows of {model.carriers} powers and of three angles")
    if not (np.isfinite(epochs_s).all() and np.isfinite(profile_deg).all() and (np.diff(epochs_s) > 0.0).all()):
        raise ValueError("epochs must increase, epochs and the profile must be finite")


#: places of the axes in yaw, roll, pitch
YAW, ROLL, PITCH = 0, 1, 2


class SlewLeg(NamedTuple):
    """One slew of a profile; it ends without a rate."""

    start_s: float
    duration_s: float
    #: change of the angle of the profile's axis
    change_deg: float


class Profile(NamedTuple):
    """Slews about one axis and the rest after each."""

    #: 0 yaw, 1 roll, 2 pitch
    axis: int
    legs: tuple[SlewLeg, ...]
    stop_s: float


def roll_profile(side_deg: float = 0.08) -> Profile:
    """Return the roll check: 45 minutes, 0.08 deg to either side, each slew 480 s."""
    return Profile(ROLL, _swing(side_deg, 480.0, 260.0), 2700.0)


def pitch_profile(side_deg: float = 0.075) -> Profile:
    """Return the pitch check: 45 minutes, a swing of 0.15 deg, each slew 300 s."""
    return Profile(PITCH, _swing(side_deg, 300.0, 500.0), 2700.0)


def _swing(side_deg: float, slew_s: float, rest_s: float) -> tuple[SlewLeg, ...]:
    """Return out, rest, back in two slews and beyond, rest, back: each slew no further than a side."""
    back_s = slew_s + rest_s
    return (
        SlewLeg(0.0, slew_s, side_deg),
        SlewLeg(back_s, slew_s, -side_deg),
        SlewLeg(back_s + slew_s, slew_s, -side_deg),
        SlewLeg(2.0 * back_s + slew_s, slew_s, side_deg),
    )


def yaw_profile(side_deg: float = 0.25, hold_s: float = 3600.0) -> Profile:
    """Return the yaw check: 4 hours, one side, the other, back; slews in parts of at most 0.1 deg."""
    parts = int(np.ceil(side_deg / 0.1 - 1e-9))
    step, slew_s = side_deg / parts, 600.0
    legs = [SlewLeg(k * slew_s, slew_s, step) for k in range(parts)]
    begin_s = parts * slew_s + hold_s
    legs += [SlewLeg(begin_s + k * slew_s, slew_s, -step) for k in range(2 * parts)]
    begin_s += 2 * parts * slew_s + hold_s
    legs += [SlewLeg(begin_s + k * slew_s, slew_s, step) for k in range(parts)]
    return Profile(YAW, tuple(legs), begin_s + parts * slew_s)
