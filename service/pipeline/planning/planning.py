"""Planning: the carriers that two rules choose from what is known of them, and what each set can see.

Known are sensitivities and noise, from a calibration or assumed for a spacecraft that was never calibrated
(assumed_beams). The rule ``optimal`` is the weighted A-optimal choice for the robust method; ``paper`` takes for each
axis the carriers that answer mostly to it and asks for stable, linear ones. Both are judged by the same figures,
beside the set of all usable carriers, and further carriers are named that would help most. Nothing is read or kept
here; every carrier is told why it was chosen or left out.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from service.core.estimation.calibration.whitened_fit import ColouredNoise
from service.core.estimation.design import (
    MIN_CARRIERS,
    MIN_REDUNDANCY,
    choose_carriers,
    largest_share,
    most_share,
    recommended_turns,
    weighted_variance_deg2,
)
from service.core.estimation.observability import SetStatistics, averaged_crlb_deg, crlb_deg, judge_set
from service.core.estimation.paper.selection import AxisSelection, SelectionReason, axis_dominance, select_by_axis
from service.pipeline.planning.candidates import NOT_MEASURED, Candidates
from service.records.epoch import US_PER_S
from service.records.levels.attitude import Axes, FloatArray, IntArray, named_axes

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
    chosen = choose_carriers(sensitivity, sigma, numbers, count, eligible=usable, level=candidates.level)
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
    share = largest_share(numbers)
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
    most = most_share(count)
    texts = (
        (
            bool(np.isfinite(figures.crlb_deg).all()),
            "the carriers do not determine three angles and a level common to all of them",
        ),
        (count >= MIN_CARRIERS, f"{count} carriers; the robust method wants at least {MIN_CARRIERS}"),
        (
            figures.redundancy >= MIN_REDUNDANCY,
            f"{figures.redundancy} carriers beyond the unknowns; {MIN_REDUNDANCY} keep faults from hiding",
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
    return weighted_variance_deg2(np.array(bounds_deg).reshape(-1, 3))


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
        costs = weighted_variance_deg2(bounds_deg)
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
    for turn in recommended_turns(far_yaw=far_yaw):
        begin_us = steps[-1].stop_us if steps else start_us
        steps.append(TurnStep(begin_us, begin_us + round(turn.minutes * 60.0 * US_PER_S), Axes(*turn.attitude_deg)))
    return tuple(steps)
