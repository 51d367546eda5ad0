"""Planning: the carriers that two rules choose from what is known of them, and what each set can see.

Known are sensitivities and noise, from a calibration or assumed for a spacecraft that was never calibrated
(assumed_beams). The rule ``optimal`` is the weighted A-optimal choice for the robust method; ``paper`` takes for each
axis the carriers that answer mostly to it and asks for stable, linear ones. Both are judged by the same figures,
beside the set of all usable carriers, and further carriers are named that would help most. Nothing is read or kept
here; every carrier is told why it was chosen or left out.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from service.core.estimation import design
from service.core.estimation.attitude_bound import DriftStatistics, WheelStatistics, attitude_bound_deg
from service.core.estimation.calibration.whitened_fit import ColouredNoise
from service.core.estimation.observability import SetStatistics, averaged_crlb_deg, crlb_deg, judge_set
from service.core.estimation.paper.selection import AxisSelection, SelectionReason, axis_dominance, select_by_axis
from service.pipeline.inputs.known_motion import rate_sensor_model
from service.pipeline.inputs.polarization import learned_feed, polarimeter_models, used_polarimeters
from service.records.calibration import CalibrationResult, CarrierCalibration, FeedFit
from service.records.catalogue import AxisTorques, CarrierPlan, FedForwardTorque, Spacecraft, WheelMomentum
from service.records.epoch import US_PER_S
from service.records.levels.attitude import Axes, BoolArray, FloatArray, IntArray, named_axes

#: fewest carriers that determine three angles and a common level
MIN_USABLE = 4
NOT_USABLE = "not usable for attitude: disabled, a beacon, or under uplink power control"
GONE = "no longer in the carrier plan"
NOT_MEASURED = "the calibration has no sensitivity of it for every axis"


@dataclass(frozen=True)
class Candidates:
    """N carriers to choose from; NaN = not known."""

    carrier_ids: tuple[str, ...]
    transponders: tuple[str, ...]
    #: (N, 3)
    sensitivity_db_per_deg: FloatArray
    noise: ColouredNoise
    #: (N,) rms after the daily harmonic, dB, and departure from a straight line, deg
    residual_rms_db: FloatArray
    nonlinearity_deg: FloatArray
    #: (N,) number of the level that a carrier shares, -1 = the one common to all that no level control holds
    level: IntArray
    #: why no rule may choose a carrier; empty = it may be chosen
    refusals: tuple[tuple[str, ...], ...]
    #: why the paper's rule may not
    paper_refusals: tuple[tuple[str, ...], ...]

    @property
    def sigma_db(self) -> FloatArray:
        """(N,) noise of one row, correlated parts included."""
        return np.asarray(np.sqrt(self.noise.white_db**2 + np.sum(self.noise.sigma_db**2, axis=1)))

    @property
    def is_usable(self) -> BoolArray:
        """(N,) whether a rule may choose the carrier."""
        return np.array([not refusal for refusal in self.refusals], dtype=np.bool_)

    @property
    def transponder_numbers(self) -> IntArray:
        """(N,) number of each carrier's transponder."""
        names = sorted(set(self.transponders))
        return np.array([names.index(name) for name in self.transponders], dtype=np.int64)

    def joined(self, others: "Candidates") -> "Candidates":
        """Return these and other carriers, whose noise has as many parts."""
        return Candidates(
            self.carrier_ids + others.carrier_ids,
            self.transponders + others.transponders,
            np.vstack([self.sensitivity_db_per_deg, others.sensitivity_db_per_deg]),
            ColouredNoise(*(np.concatenate(parts) for parts in zip(self.noise, others.noise, strict=True))),
            np.concatenate([self.residual_rms_db, others.residual_rms_db]),
            np.concatenate([self.nonlinearity_deg, others.nonlinearity_deg]),
            np.concatenate([self.level, others.level]),
            self.refusals + others.refusals,
            self.paper_refusals + others.paper_refusals,
        )


def candidates_of(result: CalibrationResult, plan: CarrierPlan) -> Candidates:
    """Return the carriers of a calibration; the newest plan says which may be used and who shares a transponder."""
    known = {carrier.id: carrier for carrier in plan.carriers}
    carriers = result.carriers
    sensitivity = np.array([carrier.sensitivity_db_per_deg for carrier in carriers], dtype=np.float64).reshape(-1, 3)
    noise = _identified_noise(carriers)
    is_kept = result.geometry.is_used if result.geometry is not None else (True,) * len(carriers)
    refusals = []
    for k, carrier in enumerate(carriers):
        texts = (
            (carrier.id in known, GONE),
            (carrier.id not in known or known[carrier.id].is_usable_for_attitude, NOT_USABLE),
            (bool(np.isfinite(sensitivity[k]).all()), NOT_MEASURED),
            (bool(np.isfinite(noise.white_db[k])), "the calibration has not learned its noise"),
            (is_kept[k], f"the calibration leaves it out: {_rejection(carrier)}"),
        )
        # the first reason is enough: what is not measured was rarely usable
        refusals.append(tuple(text for is_met, text in texts if not is_met)[:1])
    return Candidates(
        tuple(carrier.id for carrier in carriers),
        tuple(known[c.id].transponder if c.id in known else "" for c in carriers),
        sensitivity,
        noise,
        np.array([carrier.stability_residual_rms_db for carrier in carriers], dtype=np.float64),
        np.array([carrier.nonlinearity_deg for carrier in carriers], dtype=np.float64),
        _levels(result),
        tuple(refusals),
        tuple(_unmet_criteria(carrier) for carrier in carriers),
    )


def _levels(result: CalibrationResult) -> IntArray:
    """Return the level that each carrier shares; a transponder under level control has its own."""
    groups = result.geometry.alc_group if result.geometry is not None else ()
    return np.array(groups or (-1,) * len(result.carriers), dtype=np.int64)


def _identified_noise(carriers: Sequence[CarrierCalibration]) -> ColouredNoise:
    """Return the noise of calibrated carriers; where it was not split, all of the residual counts as white."""
    size = max([1, *(len(carrier.noise) for carrier in carriers)])
    sigma, tau = np.zeros((len(carriers), size)), np.ones((len(carriers), size))
    white = np.array([carrier.sigma_white_db for carrier in carriers], dtype=np.float64)
    for k, carrier in enumerate(carriers):
        for position, part in enumerate(carrier.noise):
            if math.isfinite(part.sigma_db) and part.correlation_time_s > 0.0:
                sigma[k, position], tau[k, position] = part.sigma_db, part.correlation_time_s
    rms = np.array([carrier.harmonic.rms_db for carrier in carriers], dtype=np.float64)
    return ColouredNoise(np.where(np.isfinite(white), white, rms), sigma, tau)


def _rejection(carrier: CarrierCalibration) -> str:
    """Return why the robust method must not use a carrier; reasons of the paper's rule are told apart from it."""
    mark = "robust: "
    own = [reason.removeprefix(mark) for reason in carrier.rejected_because if reason.startswith(mark)]
    return "; ".join(own or carrier.rejected_because) or "no reason kept"


def _unmet_criteria(carrier: CarrierCalibration) -> tuple[str, ...]:
    """Return which criteria of the paper a carrier fails, with its figures."""
    texts = (
        ("stable", f"not stable: rms {carrier.stability_residual_rms_db:.3f} dB"),
        ("linear", f"not linear: departs {carrier.nonlinearity_deg:.3f} deg"),
    )
    return tuple(text for name, text in texts if name not in carrier.criteria_met)


#: time between records where none is stated, s
WHEEL_PERIOD_S = 300.0
#: what three quiet days tell of a feed: offset, daily cosine and sine, one sigma of 0.02 and 0.01 deg
_QUIET_FEED = FeedFit((0.0, 0.0, 0.0), ((4e-4, 0.0, 0.0), (0.0, 1e-4, 0.0), (0.0, 0.0, 1e-4)), 0.0, 0.0, 0)


class MomentumGain(NamedTuple):
    """Bounds of a filter over a day, one sigma, by a set of carriers."""

    wheels: WheelStatistics
    #: deg; NaN = the carriers do not determine it
    without_deg: Axes
    with_deg: Axes


class MotionGain(NamedTuple):
    """Bounds of a filter over a day, one sigma, deg, by a set of carriers and what the catalogue states beside them.

    NaN = the carriers do not determine it; None = nothing is stated.
    """

    powers_deg: Axes
    rates_deg: Axes | None
    polarization_deg: Axes | None
    #: wheels, rates and polarimeters together
    all_deg: Axes


def stated_wheels(
    stated: WheelMomentum | None, bias_n_m_s: float | None, sigma_n_m_s: float | None, period_s: float
) -> WheelStatistics | None:
    """Return the wheels by the options given, else by the catalogue; None where neither states a momentum."""
    known = stated or WheelMomentum()
    bias = known.pitch_bias_n_m_s if bias_n_m_s is None else bias_n_m_s
    if bias is None:
        return None
    wheels = WheelStatistics(bias, sigma_n_m_s or known.sigma_n_m_s, period_s, known.misalignment_deg)
    return wheels if known.torque is None else wheels._replace(torque_error_n_m=_error_n_m(known.torque))


def momentum_gain(candidates: Candidates, chosen: IntArray, wheels: WheelStatistics) -> MomentumGain:
    """Return the bounds by some carriers; their noise is that of a row a minute."""
    powers = _powers(candidates, chosen)
    bounds = (attitude_bound_deg(*powers, one) for one in (None, wheels))
    without_deg, with_deg = (named_axes(bound) for bound in bounds)
    return MomentumGain(wheels, without_deg, with_deg)


def motion_gain(
    candidates: Candidates, chosen: IntArray, spacecraft: Spacecraft, wheels: WheelStatistics | None
) -> MotionGain | None:
    """Return the bounds by some carriers; None where neither a rate sensor nor a polarimeter is stated and used."""
    sensor, stated = rate_sensor_model(spacecraft), used_polarimeters(spacecraft)
    if sensor is None and not stated:
        return None
    powers, models = _powers(candidates, chosen), polarimeter_models(spacecraft, stated)
    # references come from quiet days, and so does what they tell of a feed
    feeds = [learned_feed(_QUIET_FEED, one, 0) for one in stated]
    read = tuple(one._replace(learned=feed) for one, feed in zip(models, feeds, strict=True))
    bias = None if sensor is None else (sensor.bias_deg_h, sensor.bias_deg_h, sensor.bias_deg_h)
    drift = (
        None if sensor is None or bias is None else DriftStatistics(bias, sensor.bias_tau_h, sensor.noise_deg_sqrt_h)
    )
    return MotionGain(
        named_axes(attitude_bound_deg(*powers)),
        None if drift is None else named_axes(attitude_bound_deg(*powers, drift=drift)),
        named_axes(attitude_bound_deg(*powers, polarimeters=read)) if read else None,
        named_axes(attitude_bound_deg(*powers, wheels, drift, read)),
    )


def _powers(candidates: Candidates, chosen: IntArray) -> tuple[FloatArray, ColouredNoise]:
    return candidates.sensitivity_db_per_deg[chosen], ColouredNoise(*(part[chosen] for part in candidates.noise))


def _error_n_m(profile: FedForwardTorque) -> float:
    """Return one sigma of what a profile has wrong: its relative error of the rms of its parts along roll and yaw."""
    parts = (profile.constant_n_m, profile.cosine_n_m, profile.sine_n_m)
    size_n_m = float(np.sqrt(np.mean([_across(part) ** 2 for part in parts])))
    return math.hypot(profile.relative_error, profile.axis_relative_error) * size_n_m


def _across(torque: AxisTorques) -> float:
    return math.hypot(torque.roll, torque.yaw) / math.sqrt(2.0)


#: spans over which averages are told, s
AVERAGING_SPANS_S = (900.0, 3600.0, 14_400.0, 43_200.0)
#: time between rows for which averages are told, s
ROW_PERIOD_S = 60.0
#: further carriers that are named
MOST_FURTHER = 3
_AXIS_NAMES = ("yaw", "roll", "pitch")


class Rule(StrEnum):
    """Rule of the choice of carriers."""

    PAPER = "paper"
    OPTIMAL = "optimal"


@dataclass(frozen=True)
class CarrierSet:
    """C carriers and their sensitivities."""

    #: in the order of choice
    chosen: IntArray
    figures: SetStatistics
    transponder_share: float
    #: what the set lacks for the robust method; empty = sufficient
    shortcomings: tuple[str, ...]
    #: sigma after each of AVERAGING_SPANS_S, deg
    averaged_deg: tuple[Axes, ...]


class CarrierWord(NamedTuple):
    """Judgement of a rule on one carrier."""

    #: rank in the order of choice, None = left out
    rank: int | None
    #: axis it was chosen for or answers to most, and how many times more than to the others
    axis: str | None
    dominance: float
    reasons: tuple[str, ...]


class FurtherCarrier(NamedTuple):
    """A carrier that would lower the bounds of the chosen set, and of those named before it, most."""

    carrier: str
    transponder: str
    #: whether the plan has it; otherwise it is a user to look for
    in_plan: bool
    #: bounds with it over bounds without it; NaN = not determined without it
    bound_ratio: Axes


@dataclass(frozen=True)
class Recommendation:
    """Recommendation of a rule, with alternative sets."""

    rule: Rule
    candidates: Candidates
    #: by name: optimal, paper, all
    sets: dict[str, CarrierSet]
    #: (N,)
    words: tuple[CarrierWord, ...]
    #: in the order of their effect
    further: tuple[FurtherCarrier, ...]


class TurnStep(NamedTuple):
    """One level of the calibration turns."""

    start_us: int
    stop_us: int
    attitude_deg: Axes


def recommend(
    candidates: Candidates, count: int, rule: Rule, *, yaw_scale: float = 8.0, offered: Candidates | None = None
) -> Recommendation:
    """Return the recommendation of a rule for some number of carriers, and the sets to compare it with.

    Further carriers are usable ones that were left out, and those offered from outside the plan. With fewer than
    MIN_USABLE usable carriers every set is there, but its figures are NaN.
    """
    usable = candidates.is_usable
    sensitivity, sigma = candidates.sensitivity_db_per_deg, candidates.sigma_db
    numbers = candidates.transponder_numbers
    chosen = design.choose_carriers(sensitivity, sigma, numbers, count, eligible=usable, level=candidates.level)
    is_sound = usable & np.array([not refusal for refusal in candidates.paper_refusals], dtype=np.bool_)
    by_axis = select_by_axis(sensitivity, is_sound, count, yaw_scale=yaw_scale)
    losses = _left_out_costs(candidates, chosen)
    ordered = chosen[np.argsort(-losses, kind="stable")]
    sets = {
        Rule.OPTIMAL.value: judged_set(candidates, ordered),
        Rule.PAPER.value: judged_set(candidates, by_axis.chosen),
        "all": judged_set(candidates, np.flatnonzero(usable)),
    }
    if rule is Rule.PAPER:
        words = tuple(_paper_word(k, candidates, by_axis) for k in range(len(usable)))
    else:
        words = tuple(_optimal_word(k, candidates, ordered, yaw_scale) for k in range(len(usable)))
    further = _further(candidates, sets[rule.value].chosen, offered)
    return Recommendation(rule, candidates, sets, words, further)


def judged_set(candidates: Candidates, chosen: IntArray) -> CarrierSet:
    """Return the figures of a set of carriers."""
    sensitivity, sigma = candidates.sensitivity_db_per_deg[chosen], candidates.sigma_db[chosen]
    noise = ColouredNoise(*(part[chosen] for part in candidates.noise))
    level = candidates.level[chosen]
    figures = judge_set(sensitivity, sigma, level)
    averaged = averaged_crlb_deg(sensitivity, noise, np.array(AVERAGING_SPANS_S), ROW_PERIOD_S, level)
    numbers = candidates.transponder_numbers[chosen]
    share = design.largest_share(numbers)
    return CarrierSet(
        chosen,
        figures,
        share,
        _shortcomings(figures, [candidates.transponders[k] for k in chosen], share),
        tuple(named_axes(row) for row in averaged),
    )


def _shortcomings(figures: SetStatistics, transponders: list[str], share: float) -> tuple[str, ...]:
    """Return the requirements that a set misses, with its figures and the required ones."""
    count = len(transponders)
    fullest = max(sorted(set(transponders)), key=transponders.count, default="")
    most = design.most_share(count)
    texts = (
        (
            bool(np.isfinite(figures.crlb_deg).all()),
            "the carriers do not determine three angles and a level common to all of them",
        ),
        (count >= design.MIN_CARRIERS, f"{count} carriers; the robust method wants at least {design.MIN_CARRIERS}"),
        (
            figures.redundancy >= design.MIN_REDUNDANCY,
            f"{figures.redundancy} carriers beyond the unknowns; {design.MIN_REDUNDANCY} keep faults from hiding",
        ),
        (
            share <= most + 1e-9,
            f"transponder {fullest} holds {share:.0%} of the carriers; more than {most:.0%} fail "
            "together when it changes",
        ),
    )
    return tuple(text for is_met, text in texts if not is_met)


def _left_out_costs(candidates: Candidates, chosen: IntArray) -> FloatArray:
    """Return the weighted sum of variances (C,) when each carrier of a set is left out; infinite = all is lost."""
    bounds_deg = [_bound_deg(candidates, chosen[chosen != k]) for k in chosen]
    return design.weighted_variance_deg2(np.array(bounds_deg).reshape(-1, 3))


def _bound_deg(candidates: Candidates, chosen: IntArray) -> FloatArray:
    """Return the bound (3,) of one row by some carriers, common level free."""
    sensitivity, sigma = candidates.sensitivity_db_per_deg[chosen], candidates.sigma_db[chosen]
    return crlb_deg(sensitivity, sigma, with_common=True, level=candidates.level[chosen])


def _further(candidates: Candidates, chosen: IntArray, offered: Candidates | None) -> tuple[FurtherCarrier, ...]:
    """Return the carriers that lower the weighted sum of variances most, one after the other."""
    every = candidates if offered is None else candidates.joined(offered)
    free = np.setdiff1d(np.flatnonzero(every.is_usable), chosen)
    found: list[FurtherCarrier] = []
    before_deg = _bound_deg(every, chosen)
    while len(found) < MOST_FURTHER and free.size:
        bounds_deg = np.array([_bound_deg(every, np.append(chosen, k)) for k in free])
        costs = design.weighted_variance_deg2(bounds_deg)
        best = int(np.argmin(costs))
        if not math.isfinite(costs[best]):
            break
        k, ratio = int(free[best]), named_axes(bounds_deg[best] / before_deg)
        found.append(FurtherCarrier(every.carrier_ids[k], every.transponders[k], k < len(candidates.level), ratio))
        before_deg, chosen, free = bounds_deg[best], np.append(chosen, k), np.delete(free, best)
    return tuple(found)


def _optimal_word(k: int, candidates: Candidates, chosen: IntArray, yaw_scale: float) -> CarrierWord:
    """Return the judgement of the optimal rule on the k-th carrier: the bounds with the other decision."""
    dominance_of = axis_dominance(candidates.sensitivity_db_per_deg[k : k + 1], yaw_scale=yaw_scale)[0]
    is_measured = bool(np.isfinite(candidates.sensitivity_db_per_deg[k]).all())
    name = _AXIS_NAMES[int(np.argmax(dominance_of))] if is_measured else None
    dominance = float(dominance_of.max())
    if candidates.refusals[k]:
        return CarrierWord(None, name, dominance, candidates.refusals[k])
    position = np.flatnonzero(chosen == k)
    if position.size:
        ratio = _bound_deg(candidates, chosen[chosen != k]) / _bound_deg(candidates, chosen)
        return CarrierWord(int(position[0]), name, dominance, (f"chosen: without it {_changes(ratio)}",))
    ratio = _bound_deg(candidates, np.append(chosen, k)) / _bound_deg(candidates, chosen)
    reason = f"as one more it would give {_changes(ratio)}; the {len(chosen)} chosen do more"
    return CarrierWord(None, name, dominance, (reason,))


def _changes(ratio: FloatArray) -> str:
    """Return by how much bounds change, in words."""
    if not np.isfinite(ratio).all():
        return "the attitude is not determined"
    # a zero without a sign: what is less than a twentieth of a per cent is no gain and no loss
    changes = [f"{value:+.1%}" if abs(value) >= 5e-4 else "0.0%" for value in (ratio - 1.0).tolist()]
    return "bounds of " + ", ".join(f"{axis} {change}" for axis, change in zip(_AXIS_NAMES, changes, strict=True))


def _paper_word(k: int, candidates: Candidates, by_axis: AxisSelection) -> CarrierWord:
    """Return the judgement of the paper's rule on the k-th carrier, with figures."""
    reason, axis = SelectionReason(int(by_axis.reason[k])), int(by_axis.axis[k])
    name = _AXIS_NAMES[axis] if axis >= 0 else None
    dominance = float(by_axis.dominance[k])
    rank = int(by_axis.rank[k]) if by_axis.rank[k] >= 0 else None
    reported = f"answers {dominance:.2f} times more to {name} than to any other axis"
    if reason is SelectionReason.CHOSEN:
        reasons: tuple[str, ...] = (f"chosen for {name}: {reported}",)
    elif reason is SelectionReason.NOT_NEEDED:
        reasons = (f"{reported}; {len(by_axis.chosen)} carriers before it do more",)
    elif reason is SelectionReason.NOT_MEASURED:
        reasons = (NOT_MEASURED,)
    else:
        reasons = candidates.refusals[k] + candidates.paper_refusals[k]
    return CarrierWord(rank, name, dominance, reasons)


def turn_timetable(start_us: int, *, far_yaw: bool = False) -> tuple[TurnStep, ...]:
    """Return the recommended calibration turns from a start on, level after level, rests at zero included."""
    steps: list[TurnStep] = []
    for turn in design.recommended_turns(far_yaw=far_yaw):
        begin_us = steps[-1].stop_us if steps else start_us
        steps.append(TurnStep(begin_us, begin_us + round(turn.minutes * 60.0 * US_PER_S), Axes(*turn.attitude_deg)))
    return tuple(steps)
