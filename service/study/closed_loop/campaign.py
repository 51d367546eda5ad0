"""The campaign: closed loops of every scenario, seed and sensing over processes, and their figures."""

import time
from collections.abc import Callable
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from service.study.closed_loop.controllers import Sensing
from service.study.closed_loop.flight_store import keep, kept
from service.study.closed_loop.merit import GroupMerit, group_merit
from service.study.closed_loop.run import LoopResult, LoopUnit, fly_unit
from service.study.executors import WorkerChoice, do_work, executor_of

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
