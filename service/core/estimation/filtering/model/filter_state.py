"""State vector of the attitude filter: which number stands where, and how blocks of it are set free.

    x = [yaw roll pitch | 3 drifts | 3 commanded rates | chain | rain | G common parts | E hidden
         | N first components | ... | N last components | N references]

Angles in deg, rates in deg/h, levels in dB. Hidden states move the spacecraft and stand in no level (`hidden_motion`);
most craft have none. A vector carries its own E. The law of this file: a mean and a covariance are values; every
function returns new ones.
"""

from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.model.filter_model import CarrierModel, FloatArray, IntArray

#: places of the core states
ATTITUDE = slice(0, 3)
DRIFT = slice(3, 6)
RATE = slice(6, 9)
CHAIN = 9
RAIN = 10
FIRST_COMMON = 11
#: variance that a freed reference gets, dB^2
FREE_REFERENCE_DB2 = 9.0
#: floor that keeps the covariance positive definite where nothing moves
RATE_FLOOR_DEG_H = 1e-4
_RAIN_FLOOR_DB = 1e-3


class Gaussian(NamedTuple):
    """Mean (D,) and covariance (D, D) of the state vector."""

    mean: FloatArray
    covariance: FloatArray

    @property
    def attitude_sigma_deg(self) -> FloatArray:
        """(3,) one standard deviation of yaw, roll, pitch, deg."""
        return np.asarray(np.sqrt(self.covariance.diagonal()[ATTITUDE]))


def rates_deg_h(mean: FloatArray, coupling_per_h: float) -> FloatArray:
    """Return the rates (3,) of yaw, roll and pitch that attitude, drift and commanded rate of a state imply."""
    yaw, roll, _pitch = mean[ATTITUDE].tolist()
    exchanged = np.array([-coupling_per_h * roll, coupling_per_h * yaw, 0.0])
    return np.asarray(exchanged + mean[DRIFT] + mean[RATE])


def common_states(model: CarrierModel) -> slice:
    """Return the places of the G parts that all carriers share."""
    return slice(FIRST_COMMON, FIRST_COMMON + len(model.common_sigma_db))


def core_size(model: CarrierModel, hidden: int = 0) -> int:
    """Return the number of states that no single carrier owns, `hidden` ones among them."""
    return FIRST_COMMON + len(model.common_sigma_db) + hidden


def hidden_count(model: CarrierModel, states: int) -> int:
    """Return how many hidden states a vector of a size has."""
    carriers, components = model.coloured_sigma_db.shape
    return int(states - core_size(model) - carriers * (components + 1))


def carrier_states(model: CarrierModel, carriers: IntArray, hidden: int = 0) -> IntArray:
    """Return the places (K + 1, n) of the states of some carriers, components first, references last."""
    blocks = core_size(model, hidden) + model.carriers * np.arange(model.components + 1)
    return np.asarray(blocks[:, None] + carriers[None, :])


def reference_states(model: CarrierModel, carriers: IntArray, hidden: int = 0) -> IntArray:
    """Return the places (n,) of the reference errors of some carriers."""
    return np.asarray(core_size(model, hidden) + model.carriers * model.components + carriers)


def initial_gaussian(
    model: CarrierModel,
    attitude_deg: FloatArray,
    attitude_sigma_deg: FloatArray,
    reference_sigma_db: FloatArray,
    *,
    drift_deg_h: tuple[float, float, float],
    chain_sigma_db: float = 0.1,
) -> Gaussian:
    """Return the state at an alignment.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    attitude_deg, attitude_sigma_deg : ndarray, shape (3,), deg
        Attitude of the alignment and one standard deviation of it.
    reference_sigma_db : ndarray, shape (N,), dB
        One standard deviation of each reference level.
    drift_deg_h : tuple of float, deg/h
        Drift of the inertial model, one standard deviation.
    chain_sigma_db : float, dB
        What all references may have wrong together.

    Returns
    -------
    Gaussian
        Coloured parts stand at zero with their stationary variance; there are no hidden states.
    """
    core = [
        attitude_sigma_deg**2,
        np.array(drift_deg_h) ** 2,
        np.full(3, RATE_FLOOR_DEG_H**2),
        np.array([chain_sigma_db**2, _RAIN_FLOOR_DB**2]),
        model.common_sigma_db**2,
    ]
    variance = np.concatenate([*core, (model.coloured_sigma_db.T**2).ravel(), reference_sigma_db**2])
    mean = np.zeros(len(variance))
    mean[ATTITUDE] = attitude_deg
    return Gaussian(mean, np.diag(variance))


def freed(state: Gaussian, positions: IntArray, variance: float) -> Gaussian:
    """Return the state in which some elements have moved together by an unknown amount.

    Parameters
    ----------
    state : Gaussian
        State before.
    positions : ndarray, shape (n,)
        Elements that moved by one and the same amount.
    variance : float
        Variance of the amount, in the unit of the states squared.
    """
    covariance = state.covariance.copy()
    covariance[np.ix_(positions, positions)] += variance
    return Gaussian(state.mean, covariance)


def reset_carriers(
    model: CarrierModel, state: Gaussian, carriers: IntArray, reference_db: FloatArray, variance_db2: FloatArray
) -> Gaussian:
    """Return the state in which some carriers begin again.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    state : Gaussian
        State before.
    carriers : ndarray, shape (n,)
        Which carriers.
    reference_db, variance_db2 : ndarray, shape (n,), dB and dB^2
        Their reference errors from now on.

    Returns
    -------
    Gaussian
        Coloured parts of these carriers at zero with stationary variance, correlated with nothing.
    """
    positions = carrier_states(model, carriers, hidden_count(model, len(state.mean)))
    mean, covariance = state.mean.copy(), state.covariance.copy()
    flat = positions.ravel()
    mean[flat] = 0.0
    covariance[flat, :] = 0.0
    covariance[:, flat] = 0.0
    covariance[flat, flat] = np.concatenate([(model.coloured_sigma_db[carriers].T ** 2).ravel(), variance_db2])
    mean[positions[-1]] = reference_db
    return Gaussian(mean, covariance)
