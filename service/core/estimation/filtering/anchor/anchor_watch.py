"""Watch of the anchor: the references of the alignment, asked every ten minutes what the attitude has wrong.

The anchor never forgets: every carrier takes part with the reference that the alignment gave it, grown by its random
walk, whatever the filter learned since. Its answer is the error of the filter's attitude as a mixture over the
hypotheses of the carriers (`carrier_mixture`), and with it protection levels. Where the references contradict the
attitude the filter starts again from them (`filtering.attitude_filter`); a smaller difference is left to the filter.

Protection levels: bounds that the error of roll, pitch or yaw passes with a stated probability.

    smallest L with   sum over combinations of p(h) P(abs(d) > L under h) <= risk

as in satellite navigation, where the combinations are those of faulty satellites. The combinations are those of
`carrier_mixture`, which have their probabilities after the data.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.filtering.anchor.carrier_mixture import HYPOTHESES, Branches, Mixture, solve_mixture
from service.core.estimation.filtering.causes.carrier_faults import CarrierWatch
from service.core.estimation.filtering.kernels.kernels import ARRAYS, AnchorKernels
from service.core.estimation.filtering.model.filter_model import ATTITUDE, CarrierModel, Gaussian, pattern_change

#: probability with which the error of a row may pass the level
RISK = 1e-4
#: sigmas that a normal error passes with it, on either side
SIGMAS_OF_RISK = 3.891


def protection_levels_deg(mixture: Mixture, risk: float = RISK, kernels: AnchorKernels = ARRAYS) -> FloatArray:
    """Return the protection levels (3,) of yaw, roll and pitch, deg, at most 3 deg."""
    sigma = np.sqrt(np.diagonal(mixture.covariance_deg2, axis1=1, axis2=2))
    return kernels.levels(mixture.probability, mixture.mean_deg, sigma, risk)


#: error of yaw, roll and pitch that the filter may have beyond its own sigma, deg
ERROR_SIGMA_DEG = (0.15, 0.10, 0.10)
#: minutes of a mean, rows from which a carrier has one
_MEAN_MINUTES, _LEAST_ROWS = 20, 5
#: what all carriers may have wrong together, dB, in the dry and while it rains over the receiving site
_CHAIN_DB, _RAIN_DB = 0.15, 1.0
#: between two questions, and so long an answer holds, us
_PERIOD_US, _VALID_US = 600_000_000, 1_800_000_000
#: a level grows with sigma by this factor until the next question
_LEVEL_SIGMAS = 4.0
#: what a reference may have wrong beyond its own sigma, dB
_OWN_ERROR_DB = 0.04
#: mean and sigma of light and of heavy rain; wet antennas are light, dB
_LIGHT_DB, _HEAVY_DB = (-0.35, 0.20), (-1.3, 0.9)
#: sigma of a level that changed, and of one that the filter learned again, dB
_CHANGED_DB, _LEARNED_DB = 1.0, 0.1
#: probability that a carrier in use, and one that is set aside, is wet or at another level
_WET, _WET_ASIDE = 0.08, 0.6
_CHANGED, _CHANGED_ASIDE = 0.01, 0.2
#: probability that a carrier is wet over whose station rain is reported, and factor of its probabilities where a report
#: says dry; reports may be wrong
_WET_REPORTED, _DRY_REPORTED = 0.5, 0.4
#: probability of a storm, and that a carrier is wet in it
_STORM, _WET_IN_STORM = 0.3, 0.45
#: reference error of the filter from which the carrier has another level, dB; probabilities that it is right, where the
#: alignment tells another and where it tells none
_MOVED_DB, _RIGHT, _RIGHT_ALONE = 0.3, 0.5, 0.8
#: sigmas and degrees of yaw, roll and pitch from which the references contradict the attitude
_CONTRADICTION_SIGMAS = 3.0
_CONTRADICTION_DEG = (np.inf, 0.04, 0.05)
_LEAST_PROBABILITY = 1e-12
_HOUR_US = 3.6e9


class AnchorWatch(NamedTuple):
    """Rows for the next question and the answer to the last one."""

    #: (_MEAN_MINUTES, N) newest last, measured minus what the site explains, dB, NaN = absent
    residuals_db: FloatArray
    #: (_MEAN_MINUTES, N) dB^2, white noise of these rows
    white_db2: FloatArray
    #: closed minutes since the alignment
    minutes: int
    #: epoch of the alignment and of the last answer, microseconds UTC
    since_us: int
    answered_us: int
    #: (3,) deg, protection levels by the last answer, NaN = there is none, and sigma of the filter then
    level_deg: FloatArray
    sigma_deg: FloatArray
    #: (3,) deg, the levels if nothing were wrong with any carrier
    nominal_deg: FloatArray
    #: (N,) likeliest of `HYPOTHESES`, its probability, NaN before an answer, and since when it is, microseconds UTC
    hypothesis: IntArray
    probability: FloatArray
    hypothesis_since_us: IntArray


class CarrierHypothesis(NamedTuple):
    """Likeliest hypothesis of one carrier; None and NaN before it was asked."""

    name: str | None
    probability: float
    #: microseconds UTC
    since_us: int | None


def calm_anchor(carriers: int, since_us: int) -> AnchorWatch:
    """Return the watch at an alignment."""
    unknown = np.full(3, np.nan)
    nothing = np.full((_MEAN_MINUTES, carriers), np.nan)
    likeliest = np.zeros(carriers, dtype=np.int64)
    return AnchorWatch(
        nothing,
        nothing,
        0,
        since_us,
        since_us,
        unknown,
        unknown,
        unknown,
        likeliest,
        np.full(carriers, np.nan),
        likeliest + since_us,
    )


def protection_now_deg(watch: AnchorWatch, epoch_us: int, sigma_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the protection levels (3,) at an epoch, and the nominal ones, deg, NaN = not known."""
    if epoch_us - watch.answered_us > _VALID_US:
        return np.full(3, np.nan), np.full(3, np.nan)
    grown_deg: FloatArray = _LEVEL_SIGMAS * np.maximum(sigma_deg - watch.sigma_deg, 0.0)
    return watch.level_deg + grown_deg, watch.nominal_deg + grown_deg


def push_residuals(watch: AnchorWatch, residual_db: FloatArray, white_db2: FloatArray) -> AnchorWatch:
    """Return the watch one minute later.

    Parameters
    ----------
    watch : AnchorWatch
        Before the minute.
    residual_db : ndarray, shape (N,), dB
        Measured minus what attitude, chain and rain of the state explain; NaN = absent.
    white_db2 : ndarray, shape (N,), dB^2
        White noise of the row.
    """
    return AnchorWatch(
        residuals_db=np.concatenate((watch.residuals_db[1:], residual_db.reshape(1, -1))),
        white_db2=np.concatenate((watch.white_db2[1:], white_db2.reshape(1, -1))),
        minutes=watch.minutes + 1,
        since_us=watch.since_us,
        answered_us=watch.answered_us,
        level_deg=watch.level_deg,
        sigma_deg=watch.sigma_deg,
        nominal_deg=watch.nominal_deg,
        hypothesis=watch.hypothesis,
        probability=watch.probability,
        hypothesis_since_us=watch.hypothesis_since_us,
    )


def is_question_due(watch: AnchorWatch, epoch_us: int) -> bool:
    """Return whether the references of the alignment are to be asked after a minute."""
    return watch.minutes <= _MEAN_MINUTES or epoch_us - watch.answered_us >= _PERIOD_US


def ask_anchor(
    model: CarrierModel,
    watch: AnchorWatch,
    carriers: CarrierWatch,
    state: Gaussian,
    epoch_us: int,
    *,
    is_raining: bool,
    reported_wet: FloatArray | None = None,
    kernels: AnchorKernels = ARRAYS,
) -> tuple[AnchorWatch, Mixture]:
    """Return the watch with the answer of the references, and the answer.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    watch : AnchorWatch
        With the newest minute.
    carriers : CarrierWatch
        Which are set aside, their references by the alignment.
    state : Gaussian
        State of the filter.
    epoch_us : int, microseconds UTC
        Of the minute.
    is_raining : bool
        Whether rain over the receiving site takes from all carriers.
    reported_wet : ndarray, shape (N,), optional
        1 where rain over the station is reported, 0 where none is, NaN where nobody says.
    kernels : AnchorKernels
        Who does the arithmetic.
    """
    rows, white = watch.residuals_db, watch.white_db2
    is_there = np.isfinite(rows)
    count = is_there.sum(axis=0)
    mean_db = np.nansum(rows, axis=0) / np.maximum(count, 1) - np.nan_to_num(carriers.aligned_reference_db)
    gradient = pattern_change(model, state.mean[ATTITUDE]).gradient_db_deg
    # what is left of rain over the site stands in the bands as rain does, an error of the chain in all alike
    share = model.rain_share if is_raining else np.ones(model.carriers)
    jacobian = np.column_stack([gradient, share])
    residual_db = np.where(count >= min(_LEAST_ROWS, watch.minutes), mean_db, np.nan)
    dry_db2 = _dry_variance_db2(model, carriers, (epoch_us - watch.since_us) / _HOUR_US)
    dry_db2 += np.where(is_there, white, 0.0).sum(axis=0) / np.maximum(count, 1) ** 2
    prior_sigma = np.append(np.hypot(ERROR_SIGMA_DEG, state.attitude_sigma_deg), _RAIN_DB if is_raining else _CHAIN_DB)
    mixture = solve_mixture(
        jacobian,
        residual_db,
        _branches(
            carriers,
            state.mean[-model.carriers :],
            dry_db2,
            np.full(model.carriers, np.nan) if reported_wet is None else reported_wet,
        ),
        prior_sigma,
        kernels,
    )
    watch = watch._replace(
        answered_us=epoch_us,
        level_deg=protection_levels_deg(mixture, kernels=kernels),
        sigma_deg=state.attitude_sigma_deg,
        nominal_deg=_nominal_levels_deg(jacobian, np.isfinite(residual_db), dry_db2, prior_sigma),
    )
    return _with_hypotheses(watch, mixture, np.isfinite(mean_db) & (count > 0), epoch_us), mixture


def _nominal_levels_deg(
    jacobian: FloatArray, is_there: BoolArray, dry_db2: FloatArray, prior_sigma: FloatArray
) -> FloatArray:
    """Return the protection levels (3,) if nothing were wrong with any carrier (N,) that is there."""
    weighted = jacobian[is_there] / dry_db2[is_there, None]
    precision = np.diag(prior_sigma**-2.0) + weighted.T @ jacobian[is_there]
    return np.asarray(SIGMAS_OF_RISK * np.sqrt(np.diagonal(np.linalg.inv(precision))[:3]))


def _with_hypotheses(watch: AnchorWatch, mixture: Mixture, is_there: BoolArray, epoch_us: int) -> AnchorWatch:
    """Return the watch with the likeliest hypothesis of each carrier (N,) that was there; the others keep theirs."""
    summed = [mixture.branch_probability[:, branches].sum(axis=1) for branches in HYPOTHESES.values()]
    probability = np.column_stack(summed)
    likeliest = np.where(is_there, probability.argmax(axis=1), watch.hypothesis)
    return watch._replace(
        hypothesis=likeliest,
        probability=np.where(is_there, probability.max(axis=1), watch.probability),
        hypothesis_since_us=np.where(likeliest == watch.hypothesis, watch.hypothesis_since_us, epoch_us),
    )


def carrier_hypotheses(watch: AnchorWatch) -> list[CarrierHypothesis]:
    """Return the likeliest hypothesis of each carrier by the last answer."""
    names = tuple(HYPOTHESES)
    each = zip(watch.hypothesis.tolist(), watch.probability.tolist(), watch.hypothesis_since_us.tolist(), strict=True)
    return [
        CarrierHypothesis(None, probability, None)
        if math.isnan(probability)
        else CarrierHypothesis(names[likeliest], probability, since_us)
        for likeliest, probability, since_us in each
    ]


def is_contradicted(mixture: Mixture) -> bool:
    """Return whether the references of the alignment contradict roll or pitch."""
    error = np.abs(mixture.error_deg)
    return bool(((error > _CONTRADICTION_SIGMAS * mixture.sigma_deg) & (error > _CONTRADICTION_DEG)).any())


def moved_anchor(
    model: CarrierModel, watch: AnchorWatch, attitude_deg: FloatArray, sigma_deg: FloatArray, mixture: Mixture
) -> AnchorWatch:
    """Return the watch of a filter whose attitude (3,) is moved by the error that was found, with its sigma (3,)."""
    gradient = pattern_change(model, attitude_deg).gradient_db_deg
    left = mixture._replace(mean_deg=mixture.mean_deg - mixture.error_deg)
    return watch._replace(
        residuals_db=watch.residuals_db - gradient @ mixture.error_deg,
        level_deg=protection_levels_deg(left),
        sigma_deg=sigma_deg,
    )


def _branches(
    carriers: CarrierWatch, reference_db: FloatArray, dry_db2: FloatArray, reported_wet: FloatArray
) -> Branches:
    """Return the hypotheses of the carriers beside the reference of the alignment."""
    is_aside, is_known = carriers.is_flagged, np.isfinite(carriers.aligned_reference_db)
    moved_db = reference_db - np.nan_to_num(carriers.aligned_reference_db)
    # a transponder's step moves references that were never learned again
    is_learned = ~is_aside & (carriers.is_relearned | (np.abs(moved_db) > _MOVED_DB))
    zeros = np.zeros(len(dry_db2))
    spread_db = np.array([0.0, _LIGHT_DB[1], _HEAVY_DB[1], _CHANGED_DB, _LEARNED_DB])
    wet, changed = np.where(is_aside, _WET_ASIDE, _WET), np.where(is_aside, _CHANGED_ASIDE, _CHANGED)
    regimes = [_with_reports(each, reported_wet) for each in (wet, np.maximum(wet, _WET_IN_STORM))]
    return Branches(
        np.column_stack([zeros, zeros + _LIGHT_DB[0], zeros + _HEAVY_DB[0], zeros, is_learned * moved_db]),
        dry_db2[:, None] + spread_db**2,
        np.log(np.stack([_probabilities(each, changed, is_learned, is_known) for each in regimes])),
        np.log([1.0 - _STORM, _STORM]),
    )


def _with_reports(wet: FloatArray, reported_wet: FloatArray) -> FloatArray:
    """Return the probabilities (N,) that carriers are wet, with what the weather service reports."""
    wet = np.where(reported_wet == 1.0, np.maximum(wet, _WET_REPORTED), wet)
    return np.asarray(np.where(reported_wet == 0.0, _DRY_REPORTED * wet, wet))


def _probabilities(wet: FloatArray, changed: FloatArray, is_learned: BoolArray, is_known: BoolArray) -> FloatArray:
    """Return the probabilities (N, B) of the branches of carriers whose aligned reference is known or not."""
    learned = np.where(is_learned, np.where(is_known, _RIGHT, _RIGHT_ALONE), 0.0)
    wet = np.where(is_known, wet * (1.0 - learned), 0.0)
    changed = np.where(is_known, changed * (1.0 - learned), 1.0 - learned)
    dry = 1.0 - wet - changed - learned
    each = np.column_stack([dry, 0.5 * wet, 0.5 * wet, changed, learned])
    return np.asarray(np.maximum(each, _LEAST_PROBABILITY))


def _dry_variance_db2(model: CarrierModel, carriers: CarrierWatch, hours: float) -> FloatArray:
    """Return the variance (N,) of the mean of a carrier with which nothing is wrong, without its white noise."""
    span = 60.0 * _MEAN_MINUTES / model.coloured_tau_s
    kept = 2.0 * (span - 1.0 + np.exp(-span)) / span**2
    slow_db2 = (model.coloured_sigma_db**2 * kept).sum(axis=1)
    return np.asarray(slow_db2 + carriers.aligned_variance_db2 + model.reference_walk_db**2 * hours + _OWN_ERROR_DB**2)
