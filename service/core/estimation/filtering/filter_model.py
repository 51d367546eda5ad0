"""Measurement model and settings of the attitude filter.

    y_i = g_i l + l' H_i l / 2 + c - kappa_i r + sum_k a_ik + b_i + white_i

y deviation in dB (power minus reference minus harmonic), l = (yaw, roll, pitch) in deg, g dB/deg, H dB/deg^2, c gain of
the receiving chain, r >= 0 rain over the receiving site, a_ik coloured noise of several correlation times, b error of
the reference. The law of this file: what a carrier does is told by arrays, what the spacecraft does by settings.

State vector of the attitude filter: which number stands where, and how blocks of it are set free.

    x = [yaw roll pitch | 3 drifts | 3 commanded rates | chain | rain | G common parts | E hidden
         | N first components | ... | N last components | N references]

Angles in deg, rates in deg/h, levels in dB. Hidden states move the spacecraft and stand in no level (`hidden_motion`);
most craft have none. A vector carries its own E. The law of this file: a mean and a covariance are values; every
function returns new ones.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray, IntArray

#: exchange of roll and yaw in the orbital frame, 1/h
ORBITAL_RATE_PER_H = 0.2625162
#: the correlation time whose coloured part also carries the error of the calibration, s
MODEL_ERROR_TAU_S = 3600.0


class CarrierModel(NamedTuple):
    """Model of N carriers: response and noise; K correlation times a carrier, G common parts."""

    #: (N, 3) dB/deg at nominal attitude, columns yaw, roll, pitch
    gradient_db_deg: FloatArray
    #: (N, 3, 3) dB/deg^2, symmetric
    hessian_db_deg2: FloatArray
    #: (N,) share of the receiving site's rain that a carrier's band takes: Ku 1, C 0.1
    rain_share: FloatArray
    #: (N,) number of each carrier's transponder
    transponder: IntArray
    #: (N,) dB, of one row
    white_sigma_db: FloatArray
    #: (N, K) dB and s, K >= 1
    coloured_sigma_db: FloatArray
    coloured_tau_s: FloatArray
    #: (N,) dB/sqrt(h)
    reference_walk_db: FloatArray
    #: (G,) dB and s, noise that all carriers share
    common_sigma_db: FloatArray
    common_tau_s: FloatArray
    #: (N, 9, 9) covariance of gradient (3) and Hessian (yy, yr, yp, rr, rp, pp) in their units
    coefficient_covariance: FloatArray

    @property
    def carriers(self) -> int:
        """Number of carriers N."""
        return len(self.rain_share)

    @property
    def sigma_db(self) -> FloatArray:
        """Noise (N,) of one row of each carrier, white and coloured, dB."""
        return np.asarray(np.sqrt(self.white_sigma_db**2 + (self.coloured_sigma_db**2).sum(axis=1)))

    @property
    def components(self) -> int:
        """Number of coloured components K of a carrier."""
        return int(self.coloured_sigma_db.shape[1])


def no_carriers() -> CarrierModel:
    """Return the model of no carrier, for motion that no level follows."""
    nothing, pairs = np.zeros(0), np.zeros((0, 1))
    return CarrierModel(
        gradient_db_deg=np.zeros((0, 3)),
        hessian_db_deg2=np.zeros((0, 3, 3)),
        rain_share=nothing,
        transponder=np.zeros(0, dtype=np.int64),
        white_sigma_db=nothing,
        coloured_sigma_db=pairs,
        coloured_tau_s=pairs,
        reference_walk_db=nothing,
        common_sigma_db=nothing,
        common_tau_s=nothing,
        coefficient_covariance=np.zeros((0, 9, 9)),
    )


class FedForward(NamedTuple):
    """Torque that the loop on board takes away by a known profile, as accelerations in deg/h^2 by yaw, roll, pitch.

        a(t) = constant + cosine cos(p) + sine sin(p)      p goes round once a period, zero at the beginning of 1970

    What is left of it is a share of the profile: one that all axes have in common, and a smaller one of each axis.
    """

    constant_deg_h2: tuple[float, float, float]
    cosine_deg_h2: tuple[float, float, float]
    sine_deg_h2: tuple[float, float, float]
    #: one standard deviation of the common share and of each axis' own
    relative_error: float
    axis_relative_error: float
    period_us: int


class LearnedMomentum(NamedTuple):
    """Torque that gathers in the wheels, and errors of their telemetry, as quiet days tell them."""

    #: (13,) constant, cosine, sine of the torque, each yaw, roll, pitch, deg/h^2, its phase that of the solar day;
    #: misalignments b about roll and yaw, deg; errors s of the scale along roll and yaw
    mean: tuple[float, ...]
    #: (13, 13)
    covariance: tuple[tuple[float, ...], ...]


class MomentumModel(NamedTuple):
    """Telemetry of the wheels' momentum and what it follows from."""

    #: noise of a record, N m s; error of the scale, relative; misalignment of the axes, deg
    sigma_n_m_s: float
    scale_error: float
    misalignment_deg: float
    #: about yaw, roll, pitch
    inertia_kg_m2: tuple[float, float, float]
    #: torque from outside that gathers in the wheels and moves nothing else; None = the one fed forward
    profile: FedForward | None = None
    #: size of that torque where nobody knows its profile, deg/h^2 about yaw, roll, pitch; None = a profile is known
    unknown_torque_deg_h2: tuple[float, float, float] | None = None
    #: N m s/sqrt(s), walk of the momentum by torques of which nobody knows
    walk_n_m_s_sqrt_s: float = 2e-5
    #: None = nothing was learned; else its torque has no profile beside the states
    learned: LearnedMomentum | None = None


class RateSensorModel(NamedTuple):
    """Rate sensor outside of the loop on board."""

    #: bias about each axis, one standard deviation, deg/h, and its correlation time, h
    bias_deg_h: float
    bias_tau_h: float
    #: angle random walk, deg/sqrt(h)
    noise_deg_sqrt_h: float


class LearnedFeed(NamedTuple):
    """Feed of a polarimeter as quiet days and turns tell it."""

    #: (3,) deg, offset of the angle, cosine and sine of its daily wave, the phase that of the solar day
    mean: tuple[float, ...]
    #: (3, 3) deg^2
    covariance: tuple[tuple[float, ...], ...]


class PolarimeterModel(NamedTuple):
    """Polarimeter that looks at the spacecraft from the ground."""

    #: turn of the body about the line of sight by yaw, roll, pitch, deg/deg
    sight: tuple[float, float, float]
    #: white noise of a record, amplitude of the daily wave, wander and its correlation time
    white_deg: float = 0.07
    daily_deg: float = 0.05
    wander_deg: float = 0.05
    wander_h: float = 4.0
    #: walk of the offset
    offset_walk_deg_sqrt_h: float = 0.003
    #: None = calibration tells nothing
    learned: LearnedFeed | None = None


class FilterSettings(NamedTuple):
    """Noise and dynamics of spacecraft and receiving chain; triples in the order yaw, roll, pitch; rates in deg/h."""

    #: exchange of roll and yaw at the orbital rate, 1/h; 0 where the on-board mode does not follow it
    coupling_per_h: float = ORBITAL_RATE_PER_H
    #: drift of the inertial model and its correlation time, h
    drift_deg_h: tuple[float, float, float] = (0.04, 0.025, 0.025)
    drift_tau_h: float = 8.0
    #: error of the effect of a commanded correction, relative, and how long one error lasts, s
    correction_scale: float = 0.05
    correction_span_s: float = 1800.0
    #: error of the effect of a torque, relative
    torque_scale: float = 0.02
    #: random walk of the receiving chain, dB/sqrt(h)
    chain_walk_db: float = 0.03
    #: rain: variance rate in rain mode and in the dry, dB a row of a minute
    rain_wet_db: float = 0.25
    rain_dry_db: float = 0.004
    #: time in which rain that is none is forgotten in the dry, s
    rain_dry_tau_s: float = 1800.0
    #: drift during an alarm about motion that nobody announced, deg/sqrt(h)
    unannounced_walk_deg: tuple[float, float, float] = (0.3, 0.15, 0.15)
    #: size of the torque that is not fed forward, as acceleration, deg/h^2, and how long what is learned of it holds, h
    torque_deg_h2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    #: size of a torque of which nothing is known; motion that nobody announced may be its work
    unknown_torque_deg_h2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    torque_tau_h: float = 24_000.0
    #: what the loop on board feeds forward; None = no profile is known
    fed_forward: FedForward | None = None
    #: telemetry of the wheels; None = it is not used
    momentum: MomentumModel | None = None
    #: noise of the rate sensor by whose rates the body moves, deg/sqrt(h); None = it moves by the inertial model
    rate_noise_deg_sqrt_h: float | None = None
    polarimeters: tuple[PolarimeterModel, ...] = ()


class KnownMotion(NamedTuple):
    """Known motion of a step from corrections and torques; triples (3,) in the order yaw, roll, pitch."""

    #: commanded through other channels, spread evenly over the step, deg
    correction_deg: FloatArray
    #: of corrections that became known after their time, applied at once, deg
    late_correction_deg: FloatArray
    #: rates that torques added within the step, deg/h
    rate_change_deg_h: FloatArray
    #: (n, 2, 3) turns of n unreported commands if executed, deg, and their rates at the end, deg/h
    unreported: FloatArray = np.zeros((0, 2, 3))


@lru_cache(maxsize=1)
def no_motion() -> KnownMotion:
    """Return the knowledge of a step in which nothing was commanded, always the same one; its arrays are read-only."""
    zeros = np.zeros(3)
    zeros.setflags(write=False)
    return KnownMotion(zeros, zeros, zeros)


class PatternChange(NamedTuple):
    """Levels that an attitude makes."""

    #: (N,) dB
    deviation_db: FloatArray
    #: (N, 3) dB/deg at this attitude
    gradient_db_deg: FloatArray


def pattern_change(model: CarrierModel, attitude_deg: FloatArray) -> PatternChange:
    """Return the level changes of the quadratic patterns at an attitude.

    Parameters
    ----------
    model : CarrierModel
        Gradients and Hessians.
    attitude_deg : ndarray, shape (3,), deg
        Yaw, roll, pitch.

    Returns
    -------
    PatternChange
        Deviations in dB and gradients in dB/deg at the attitude.
    """
    bend = (model.hessian_db_deg2.reshape(-1, 3) @ attitude_deg).reshape(-1, 3)
    gradient = model.gradient_db_deg + bend
    return PatternChange((model.gradient_db_deg + 0.5 * bend) @ attitude_deg, gradient)


def model_error_component(coloured_tau_s: FloatArray) -> IntArray:
    """Return which of the coloured components (N, K) of each carrier also carries the error of the calibration, (N,).

    An error of the coefficients stays as long as an attitude does, so the component of about an hour is the nearest.
    """
    component: IntArray = np.abs(np.log(coloured_tau_s / MODEL_ERROR_TAU_S)).argmin(axis=1)
    return component


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
    rates_deg_h = mean[DRIFT] + mean[RATE]
    rates_deg_h[0] -= coupling_per_h * mean[1]
    rates_deg_h[1] += coupling_per_h * mean[0]
    return rates_deg_h


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
