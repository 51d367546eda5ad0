"""Task carriers to plan carriers: rows leave in the order of the service's carrier plan.

A plan carrier that the task does not measure is sent as null with the flag NOT_MEASURED; a task carrier that the plan
does not know cannot be sent and is named in the log.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isnan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.frontend.evaluation import MeasuredRow
from service.records.epoch import format_epoch
from service.records.quality_flag import QualityFlag

#: decimals of a level on the wire, dB: far below the float32 that the archive keeps
LEVEL_DECIMALS = 5


class PlanMismatchError(Exception):
    """The plan and the task have no carrier in common, or the answer holds no plan."""


@dataclass(frozen=True, slots=True)
class PlanBinding:
    """One carrier plan and where its carriers stand in the task."""

    plan_id: int
    #: (N,) place in the task, -1 = not measured
    places: NDArray[np.int64]
    #: task carriers that the plan does not know
    unknown: tuple[str, ...]
    #: plan carriers that the task does not measure
    unmeasured: tuple[str, ...]

    def as_json(self, row: MeasuredRow) -> dict[str, Any]:
        """Return a row as the contract has it."""
        power = np.append(row.power_dbm, np.nan)[self.places]
        flags = np.append(row.flags, int(QualityFlag.NOT_MEASURED))[self.places]
        levels = np.round(power, LEVEL_DECIMALS).tolist()
        return {
            "epoch": format_epoch(row.epoch_us),
            "power_dbm": [None if isnan(level) else level for level in levels],
            "flags": flags.tolist(),
        }


def bind_plan(plan: Mapping[str, Any], task_ids: Sequence[str]) -> PlanBinding:
    """Return the binding of a plan as ``GET .../carriers`` answers it.

    Raises
    ------
    PlanMismatchError
        There is no plan, or no carrier of the task is in it.
    """
    plan_id, carriers = plan.get("plan_id"), plan.get("carriers")
    if not isinstance(plan_id, int) or not isinstance(carriers, list):
        raise PlanMismatchError("the spacecraft has no carrier plan yet")
    plan_ids = [str(carrier["id"]) for carrier in carriers]
    places = {carrier_id: place for place, carrier_id in enumerate(task_ids)}
    binding = PlanBinding(
        plan_id,
        np.array([places.get(carrier_id, -1) for carrier_id in plan_ids], dtype=np.int64),
        tuple(carrier_id for carrier_id in task_ids if carrier_id not in set(plan_ids)),
        tuple(carrier_id for carrier_id in plan_ids if carrier_id not in places),
    )
    if len(binding.unknown) == len(task_ids):
        raise PlanMismatchError(f"no carrier of the task stands in plan {plan_id}: {', '.join(task_ids[:5])} ...")
    return binding
