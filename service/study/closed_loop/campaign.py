"""The campaign: closed loops of every scenario, seed and sensing over processes, and their figures."""

import time
from collections.abc import Callable
from concurrent.futures import as_completed
from dataclasses import dataclass
from typing import NamedTuple

from service.study.closed_loop.controllers import Sensing
from service.study.closed_loop.merit import GroupMerit, group_merit
from service.study.closed_loop.run import LoopResult, LoopUnit, fly_unit
from service.study.estimation.campaign import do_work, process_pool

#: called after each run with how many are done and how many there are
Show = Callable[[int, int], None]


class LoopPlan(NamedTuple):
    """What to run."""

    scenarios: tuple[str, ...]
    runs: int
    workers: int = 2
    uplink: str = "link"
    operation_days: float | None = None
    #: drift of the inertial model that the filter believes in, deg/h, yaw, roll, pitch; None = the product's
    drift_deg_h: tuple[float, float, float] | None = None
    #: sigma of yaw up to which it is controlled, deg; None = the product's
    yaw_sigma_deg: float | None = None


@dataclass(frozen=True)
class LoopCampaign:
    """What came out of a campaign."""

    plan: LoopPlan
    seconds: float
    results: tuple[LoopResult, ...]
    groups: tuple[GroupMerit, ...]

    @property
    def missed(self) -> tuple[GroupMerit, ...]:
        """Groups that did not do what was asked: control that fails, and no control that does not."""
        return tuple(group for group in self.groups if group.is_met == (group.sensing is Sensing.OFF))


def run_loops(plan: LoopPlan, show: Show) -> LoopCampaign:
    """Fly every unit of a plan.

    Raises
    ------
    PlantFailedError
        The plant does not know a scenario, or failed.
    BrokenExecutor
        A process of the study was ended by someone else.
    """
    began_s = time.monotonic()
    keys = [(scenario, sensing) for scenario in plan.scenarios for sensing in Sensing]
    units = {
        key: [
            LoopUnit(*_named(key, seed), plan.uplink, plan.operation_days, plan.drift_deg_h, plan.yaw_sigma_deg)
            for seed in range(1, plan.runs + 1)
        ]
        for key in keys
    }
    # the slow ones first
    queue = sorted((unit for some in units.values() for unit in some), key=lambda u: u.sensing is not Sensing.AUTOMATIC)
    with process_pool(plan.workers) as pool:
        flying = {pool.submit(do_work, fly_unit, unit): unit for unit in queue}
        flown: dict[LoopUnit, LoopResult] = {}
        for number, done in enumerate(as_completed(flying), start=1):
            flown[flying[done]] = done.result()
            show(number, len(flying))
    groups = tuple(group_merit([flown[unit] for unit in units[key]]) for key in keys)
    results = tuple(flown[unit] for some in units.values() for unit in some)
    return LoopCampaign(plan, time.monotonic() - began_s, results, groups)


def _named(key: tuple[str, Sensing], seed: int) -> tuple[str, int, Sensing]:
    return key[0], seed, key[1]
