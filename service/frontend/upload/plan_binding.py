"""Task carriers to plan carriers: rows leave in the order of the service's carrier plan.

A plan carrier that the task does not measure is sent as null with the flag NOT_MEASURED; a task carrier that the plan
does not know cannot be sent and is named in the log. Rows that waited while the plan was replaced by one without any
of their carriers go under the plan that they were measured for.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.client.problem import ProblemError
from service.client.service_client import ServiceClient
from service.core.radio.decibel import FloatArray
from service.frontend.acquisition.evaluation import MeasuredRow
from service.frontend.upload.answers import DETAIL_DECIMALS
from service.records.epoch import format_epoch
from service.records.levels.quality_flag import QualityFlag

#: decimals of a level on the wire, dB: far below the float32 that the archive keeps
LEVEL_DECIMALS = 5
#: plans before the newest one that are looked at for carriers that it does not know
EARLIER_PLANS = 20


class PlanMismatchError(Exception):
    """The plan and the task have no carrier in common, or the answer holds no plan."""


@dataclass(frozen=True, slots=True)
class PlanBinding:
    """One carrier plan and where its carriers stand in the task."""

    plan_id: int
    #: (N,) place in the task, -1 = not measured
    positions: NDArray[np.int64]
    #: task carriers that the plan does not know
    unknown: tuple[str, ...]
    #: plan carriers that the task does not measure
    unmeasured: tuple[str, ...]

    def as_json(self, row: MeasuredRow, *, with_details: bool = True) -> dict[str, Any]:
        """Return a row as the contract has it; figures beside the powers that no carrier has are left out."""
        flags = np.append(row.flags, int(QualityFlag.NOT_MEASURED))[self.positions]
        reported: dict[str, Any] = {
            "epoch": format_epoch(row.epoch_us),
            "power_dbm": self._listed(row.power_dbm, LEVEL_DECIMALS),
            "flags": flags.tolist(),
        }
        for name, decimals in DETAIL_DECIMALS.items() if with_details else ():
            figures = self._listed(getattr(row, name), decimals)
            if any(figure is not None for figure in figures):
                reported[name] = figures
        return reported

    def _listed(self, values: FloatArray, decimals: int) -> list[float | None]:
        """Return figures of the task in the order of the plan; null where there is none."""
        figures = np.round(np.append(values, np.nan)[self.positions], decimals).tolist()
        return [figure if isfinite(figure) else None for figure in figures]


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
    positions = {carrier_id: position for position, carrier_id in enumerate(task_ids)}
    binding = PlanBinding(
        plan_id,
        np.array([positions.get(carrier_id, -1) for carrier_id in plan_ids], dtype=np.int64),
        tuple(carrier_id for carrier_id in task_ids if carrier_id not in set(plan_ids)),
        tuple(carrier_id for carrier_id in plan_ids if carrier_id not in positions),
    )
    if len(binding.unknown) == len(task_ids):
        raise PlanMismatchError(f"no carrier of the task is in plan {plan_id}: {', '.join(task_ids[:5])} ...")
    return binding


def find_binding(
    client: ServiceClient, spacecraft_id: str, task_ids: Sequence[str], kept_plan_id: int | None = None
) -> PlanBinding:
    """Return the binding to the newest plan that holds a carrier of the task; rows may be older than the newest plan.

    Parameters
    ----------
    client, spacecraft_id
        The service.
    task_ids : sequence of str
        Carriers of the task.
    kept_plan_id : int or None
        Plan under which rows that may go again were sent; taken while the service knows it.

    Raises
    ------
    PlanMismatchError
        None of the newest plans does.
    ClientError
        The service refused or did not answer.
    """
    if kept_plan_id is not None:
        with suppress(PlanMismatchError, ProblemError):
            return bind_plan(client.carriers(spacecraft_id, kept_plan_id), task_ids)
    newest = client.carriers(spacecraft_id)
    try:
        return bind_plan(newest, task_ids)
    except PlanMismatchError as mismatch:
        plan_id = newest.get("plan_id")
        if not isinstance(plan_id, int):
            raise
        for earlier in range(plan_id - 1, max(plan_id - 1 - EARLIER_PLANS, 0), -1):
            with suppress(PlanMismatchError, ProblemError):
                return bind_plan(client.carriers(spacecraft_id, earlier), task_ids)
        raise mismatch from None
