"""The campaign: closed loops of every scenario, seed and sensing over processes, their figures and report."""

import json
import math
import time
from collections.abc import Callable
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import TypeAdapter

from service.study.closed_loop.controllers import Sensing
from service.study.closed_loop.run import PERCENTILES, FlownRun, GroupMerit, LoopResult, LoopUnit, fly_unit, group_merit
from service.study.executors import WorkerChoice, do_work, executor_of

_UNIT = TypeAdapter(LoopUnit)
_ARRAYS = ("hours", "truth_deg", "estimate_deg", "is_inhibited", "is_faded")


def keep(folder: Path, result: LoopResult) -> None:
    """Write a result; what is half written is not there."""
    flight = result.flight
    head = {
        "unit": result.unit._asdict(),
        "seconds": result.seconds,
        "refusal": result.refusal,
        "flight": None
        if flight is None
        else {name: value for name, value in asdict(flight).items() if name not in _ARRAYS},
    }
    arrays = {} if flight is None else {name: getattr(flight, name) for name in _ARRAYS}
    folder.mkdir(parents=True, exist_ok=True)
    path = _path(folder, result.unit)
    half = path.with_suffix(".half")
    with half.open("wb") as file:
        np.savez_compressed(file, head=np.array(json.dumps(head)), **arrays)
    half.replace(path)


def kept(folder: Path, unit: LoopUnit) -> LoopResult | None:
    """Return the result of a unit that was kept; None where there is none, or one of another length or setting."""
    path = _path(folder, unit)
    if not path.exists():
        return None
    with np.load(path) as stored:
        head = json.loads(str(stored["head"]))
        if _UNIT.validate_python(head["unit"]) != unit:
            return None
        flight = None
        if head["flight"] is not None:
            rest = {name: tuple(value) if isinstance(value, list) else value for name, value in head["flight"].items()}
            flight = FlownRun(**{name: stored[name] for name in _ARRAYS}, **rest)  # type: ignore[arg-type]
    return LoopResult(unit, head["seconds"], head["refusal"], flight)


def _path(folder: Path, unit: LoopUnit) -> Path:
    return folder / f"{unit.scenario}-{unit.method.value}-{unit.sensing.value}-{unit.seed}.npz"


#: called after each run with how many are done and how many there are
Show = Callable[[int, int], None]


class LoopPlan(NamedTuple):
    """Plan of a campaign: scenarios, runs and sensings."""

    scenarios: tuple[str, ...]
    runs: int
    workers: WorkerChoice = WorkerChoice()
    sensings: tuple[Sensing, ...] = tuple(Sensing)
    #: what all runs have in common beside scenario, seed and sensing
    unit: LoopUnit = LoopUnit("", 0, Sensing.AUTOMATIC)


@dataclass(frozen=True)
class LoopCampaign:
    """Results of a campaign of closed loops."""

    plan: LoopPlan
    seconds: float
    results: tuple[LoopResult, ...]
    groups: tuple[GroupMerit, ...]

    @property
    def missed(self) -> tuple[GroupMerit, ...]:
        """Groups that miss their requirement: control that fails, and no control that succeeds."""
        return tuple(group for group in self.groups if group.is_met == (group.sensing is Sensing.OFF))


def run_loops(plan: LoopPlan, show: Show, folder: Path | None = None) -> LoopCampaign:
    """Fly every unit of a plan.

    Parameters
    ----------
    plan : LoopPlan
        What to fly.
    show : callable
        Told after each run.
    folder : Path, optional
        Keeps each flight as it ends; what it has kept before is not flown again.

    Raises
    ------
    PlantFailedError
        The plant does not know a scenario, or failed.
    BrokenExecutor, ClusterError
        A process of the study was ended by someone else, or the cluster cannot compute.
    """
    began_s = time.monotonic()
    keys = [(scenario, sensing) for scenario in plan.scenarios for sensing in plan.sensings]
    units = {
        (scenario, sensing): [
            plan.unit._replace(scenario=scenario, seed=seed, sensing=sensing) for seed in range(1, plan.runs + 1)
        ]
        for scenario, sensing in keys
    }
    # the slow ones first
    queue = sorted((unit for some in units.values() for unit in some), key=lambda u: u.sensing is not Sensing.AUTOMATIC)
    flown = {} if folder is None else {unit: old for unit in queue if (old := kept(folder, unit)) is not None}
    show(len(flown), len(queue))
    with executor_of(plan.workers) as pool:
        flying = {pool.submit(do_work, fly_unit, unit): unit for unit in queue if unit not in flown}
        for done in as_completed(flying):
            flown[flying[done]] = done.result()
            if folder is not None:
                keep(folder, done.result())
            show(len(flown), len(queue))
    groups = tuple(group_merit([flown[unit] for unit in units[key]]) for key in keys)
    results = tuple(flown[unit] for some in units.values() for unit in some)
    return LoopCampaign(plan, time.monotonic() - began_s, results, groups)


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
