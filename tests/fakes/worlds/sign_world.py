"""Powers of a spacecraft that answers commands with some sign: a simulation of its own, many runs at once."""

import numpy as np

from service.core.arrays import FloatArray
from service.core.control import sign_check
from service.core.control.sign_check import ROLL, YAW, Profile, Sign, SignContext, SignDecision, SignLikelihoods, decide
from service.core.estimation.filtering.filter_model import CarrierModel

#: white noise of a row and coloured parts as (dB, s), those that the links of rf-attitude.md have
NOMINAL = (0.155, ((0.09, 1200.0),))
FLICKER = (0.10, ((0.07, 300.0), (0.07, 3600.0), (0.07, 43_200.0)))
LOUD = (0.25, ((0.15, 1200.0),))


def payload(seed: int, carriers: int = 16) -> CarrierModel:
    """Return a payload seen from 90 E with stations over Russia and shaped beams, noise as nominal."""
    rng = np.random.default_rng(seed)
    el, az = np.radians(rng.uniform(6.3, 8.5, carriers)), np.radians(rng.uniform(-5.2, 5.0, carriers))
    slope_x, slope_y = rng.normal(0.0, 1.2, carriers), rng.normal(0.0, 1.4, carriers)
    hessian = np.zeros((carriers, 3, 3))
    hessian[:, 1, 1], hessian[:, 2, 2] = -2.7, -1.5
    white_db, coloured = NOMINAL
    return CarrierModel(
        gradient_db_deg=np.stack([-el * slope_x + az * slope_y, -slope_y, -slope_x], axis=1),
        hessian_db_deg2=hessian,
        rain_share=np.ones(carriers),
        transponder=np.zeros(carriers, dtype=np.int64),
        white_sigma_db=np.full(carriers, white_db),
        coloured_sigma_db=np.full((carriers, 1), coloured[0][0]),
        coloured_tau_s=np.full((carriers, 1), coloured[0][1]),
        reference_walk_db=np.full(carriers, 0.003),
        common_sigma_db=np.zeros(0),
        common_tau_s=np.zeros(0),
        coefficient_covariance=np.zeros((carriers, 9, 9)),
    )


def powers_db(
    model: CarrierModel,
    epochs_s: np.ndarray,
    profile: Profile,
    sign: Sign,
    runs: int,
    rng: np.random.Generator,
    noise: tuple = NOMINAL,
) -> np.ndarray:
    """Return deviations (R, T, N), dB: levels off, chain walking, inertial drift, white and coloured noise."""
    rows, carriers = len(epochs_s), model.carriers
    white_db, coloured = noise
    powers = rng.normal(0.0, white_db, (runs, rows, carriers))
    steps_s = np.diff(epochs_s, prepend=epochs_s[0])
    for sigma_db, tau_s in coloured:
        level = rng.normal(0.0, sigma_db, (runs, carriers))
        for k, step_s in enumerate(steps_s):
            keep = np.exp(-step_s / tau_s)
            level = keep * level + np.sqrt(1.0 - keep**2) * sigma_db * rng.normal(size=level.shape)
            powers[:, k] += level
    hours = epochs_s / 3600.0
    drift = rng.normal(size=(runs, 1, 3)) * [0.05, 0.04, 0.035]
    turn = sign.value * profile_angles_deg(profile, epochs_s) + drift * hours[:, None]
    powers += turn @ model.gradient_db_deg.T
    powers += 0.5 * np.einsum("rti,nij,rtj->rtn", turn, model.hessian_db_deg2, turn)
    walk = np.cumsum(rng.normal(size=(runs, rows, 1)) * 0.03 * np.sqrt(steps_s / 3600.0)[:, None], axis=1)
    return powers + walk + rng.normal(0.0, 0.5, (runs, 1, 1)) + rng.normal(0.0, 0.5, (runs, 1, carriers))


def decisions(model: CarrierModel, epochs_s: np.ndarray, profile: Profile, powers: np.ndarray) -> list[SignDecision]:
    """Return what `weigh` and `decide` say of each run; one factor serves all of them."""
    still = SignContext(np.zeros(3))
    turn = profile_angles_deg(profile, epochs_s)
    rows, carriers = len(epochs_s), model.carriers
    covariance = sign_check._covariance(model, epochs_s, still, np.ones((rows, carriers), dtype=bool))
    sums = []
    for sign in (Sign.PLUS, Sign.NOTHING, Sign.MINUS):
        residual = powers - sign_check._signature(model, still.attitude_deg, sign.value * turn)
        white = sign_check._whitened(covariance, residual.reshape(len(powers), -1).T)
        sums.append((white**2).reshape(rows, carriers, -1).sum(axis=1).cumsum(axis=0))
    values = carriers * np.arange(1, rows + 1)
    squares = np.stack(sums, axis=-1)
    return [
        decide(SignLikelihoods(-0.5 * squares[:, run], squares[:, run].min(axis=1) / values, values))
        for run in range(len(powers))
    ]


def expected_ratio(
    model: CarrierModel, epochs_s: FloatArray, profile_deg: FloatArray, context: SignContext
) -> FloatArray:
    """Return the mean log-likelihood ratio (T,) of the true PLUS against NOTHING, for the choice of a profile.

    Its standard deviation is the square root of twice the mean; against MINUS both are about four and two times that.
    """
    still = sign_check._signature(model, context.attitude_deg, 0.0 * profile_deg)
    moved = sign_check._signature(model, context.attitude_deg, profile_deg) - still
    everywhere = np.ones(moved.shape, dtype=np.bool_)
    covariance = sign_check._covariance(model, epochs_s, context, everywhere)
    white = sign_check._whitened(covariance, moved.reshape(-1, 1)).reshape(moved.shape)
    return np.asarray(0.5 * (white**2).sum(axis=1).cumsum())


def greatest_loss_deg(profile: Profile) -> float:
    """Return how far yaw, roll or pitch leaves its place at most if the sign of the profile's axis is wrong."""
    epochs_s = np.arange(0.0, profile.stop_s + 1.0, 10.0)
    turn = np.abs(profile_angles_deg(profile, epochs_s)).max(axis=0)
    return float(turn.max())


def profile_angles_deg(profile: Profile, epochs_s: FloatArray, coupling_per_h: float = 0.2625162) -> FloatArray:
    """Return the turn (T, 3), deg, that a profile makes by some epochs (T,), s.

    Parameters
    ----------
    profile : Profile
        Slews at a steady rate between their pulses.
    epochs_s : ndarray, shape (T,), s
        From the beginning of the profile.
    coupling_per_h : float, 1/h
        Exchange of roll and yaw; a turn about yaw drags roll behind it (and a turn about roll yaw), to first order.
    """
    turn = np.zeros((len(epochs_s), 3))
    dragged = np.zeros(len(epochs_s))
    for leg in profile.legs:
        since_s = np.maximum(0.0, epochs_s - leg.start_s)
        beyond_s = np.maximum(0.0, since_s - leg.duration_s)
        turn[:, profile.axis] += leg.change_deg * np.minimum(1.0, since_s / leg.duration_s)
        # integral over time, deg h
        area = 0.5 * (since_s**2 - beyond_s**2) / leg.duration_s
        dragged += leg.change_deg * area / 3600.0
    if profile.axis == YAW:
        turn[:, ROLL] = coupling_per_h * dragged
    elif profile.axis == ROLL:
        turn[:, YAW] = -coupling_per_h * dragged
    return turn
