"""Campaign as one document for programs; what JSON cannot hold is null."""

import math
from typing import Any

from service.study.estimation.bounds import Judged, Limit
from service.study.estimation.campaign import Campaign, versions


def as_document(campaign: Campaign, command: str) -> dict[str, Any]:
    """Return everything a program may want, fit for JSON."""
    plan = campaign.plan
    statistics: dict[str, dict[str, dict[str, float | None]]] = {}
    for (scenario, answer), reported in campaign.statistics.items():
        statistics.setdefault(scenario, {})[answer] = {name: _finite(value) for name, value in reported.items()}
    return {
        "command": command,
        "versions": versions(),
        "seeds": list(range(1, plan.seeds + 1)),
        "operation_days": plan.operation_days,
        "seconds": round(campaign.seconds, 1),
        "figures": statistics,
        "bounds": [_bound_document(judged) for judged in campaign.judged],
        "missed": len(campaign.missed),
        "refusals": [
            {"scenario": run.unit.scenario, "seed": run.unit.seed, "detail": run.refusal} for run in campaign.refusals
        ],
        "baselines_that_keep_all_bounds": [
            {"scenario": scenario, "baseline": baseline} for scenario, baseline in campaign.idle
        ],
    }


def _bound_document(judged: Judged) -> dict[str, Any]:
    """Return one bound with its mark."""
    bound = judged.bound
    return {
        "scenario": bound.scenario,
        "method": bound.method,
        "figure": bound.figure,
        "value": None if judged.value is None else _finite(judged.value),
        "must": _interval(bound.must),
        "goal": _interval(bound.goal),
        "goal_asked": bound.is_goal_asked,
        "source": bound.source,
        "mark": judged.mark.value,
    }


def _interval(limit: Limit | None) -> list[float | None] | None:
    """Return a limit as its two ends, None for an open one."""
    return None if limit is None else [_finite(limit.low), _finite(limit.high)]


def _finite(value: float) -> float | None:
    """Return a number that JSON can hold."""
    return value if math.isfinite(value) else None
