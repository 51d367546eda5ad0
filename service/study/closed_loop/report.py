"""Report of a campaign of closed loops: a table for people, a document for programs."""

import math
from dataclasses import asdict
from typing import Any

from service.study.closed_loop.campaign import LoopCampaign
from service.study.closed_loop.controllers import Sensing
from service.study.closed_loop.merit import PERCENTILES, GroupMerit

COLUMNS = (
    "scenario",
    "sensing",
    "runs",
    "within .4/.2/.2",
    "within .5/.3/.3",
    "roll, pitch within .2",
    "largest yaw/roll/pitch, deg (50 %)",
    "(all)",
    "impulse yaw/roll/pitch, N m s (50 %)",
    "inhibited, h (50 %, all; longest)",
    "limits of its own kept",
    "back after h",
    "verdict",
)


def cells(group: GroupMerit) -> tuple[str, ...]:
    """Return a line of the table."""
    return (
        group.scenario,
        group.sensing.value,
        f"{group.runs}" if not group.refused else f"{group.runs} ({group.refused} refused)",
        f"{group.narrow_share:.0%}",
        f"{group.wide_share:.0%}",
        f"{group.level_share:.0%}",
        _triple(group.largest_deg[0], 3),
        _triple(group.largest_deg[-1], 3),
        _triple(group.impulse_n_m_s[0], 3),
        f"{group.inhibited_h[0]:.1f}, {group.inhibited_h[-1]:.1f}; {group.longest_inhibited_h:.2f}",
        "-" if group.survived_share is None else f"{group.survived_share:.0%}",
        "-" if group.settled_h is None else f"{group.settled_h:.1f}",
        verdict(group),
    )


def verdict(group: GroupMerit) -> str:
    """Return whether a group does what it shall: control reaches the figures, no control fails."""
    if group.sensing is Sensing.OFF:
        return "does not fail" if group.is_met else "fails as it must"
    return "met" if group.is_met else "missed"


def markdown(campaign: LoopCampaign) -> str:
    """Return the table as a section of a page."""
    lines = [f"| {' | '.join(COLUMNS)} |", f"|{'---|' * len(COLUMNS)}"]
    return "\n".join([*lines, *(f"| {' | '.join(cells(group))} |" for group in campaign.groups)]) + "\n"


def as_document(campaign: LoopCampaign, command: str) -> dict[str, Any]:
    """Return figures and runs as JSON has them; what is not finite is null."""
    runs = [
        {
            "scenario": result.unit.scenario,
            "seed": result.unit.seed,
            "sensing": result.unit.sensing.value,
            "refusal": result.refusal,
            "sent": None if result.flight is None else result.flight.sent,
            "reported": None if result.flight is None else result.flight.reported,
            "seconds": round(result.seconds, 1),
        }
        for result in campaign.results
    ]
    groups = [{**asdict(group), "verdict": verdict(group)} for group in campaign.groups]
    document = {"command": command, "percentiles": PERCENTILES, "groups": groups, "runs": runs}
    plain: dict[str, Any] = _finite(document)
    return plain


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _triple(values: tuple[float, float, float], positions: int) -> str:
    return "/".join(f"{value:.{positions}f}" for value in values)
