"""Answers of the service to an upload, the lanes of rows, and the carrier plan that a task is bound to."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum, auto
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.client.problem import ProblemError
from service.client.service_client import ServiceClient
from service.core.arrays import FloatArray
from service.frontend.acquisition.evaluation import MeasuredRow
from service.records.epoch import format_epoch
from service.records.levels.measurement import QualityFlag

#: HTTP status of a body that is too long
TOO_LARGE = 413
#: figures that a row may carry beside its powers, and the decimals worth sending
DETAIL_DECIMALS = {"sigma_db": 5, "c_n0_db_hz": 3, "occupied_bandwidth_hz": 1, "centroid_offset_hz": 1}


class BatchAction(Enum):
    """Action after a batch that was refused as a whole."""

    SHORTER = auto()
    WITHOUT_DETAILS = auto()
    PARTED = auto()
    NEW_PLAN = auto()
    WAIT = auto()


class BatchReply(NamedTuple):
    """Outcome of the rows of a batch."""

    accepted: int
    duplicates: int
    late: int
    #: place in the batch -> code, words
    refused: dict[int, tuple[str, str]]


def read_receipt(reply: Any, rows: int) -> BatchReply | None:
    """Return the content of a 2xx answer; None when it does not account for every row, once."""
    try:
        accepted, duplicates, late = int(reply["accepted"]), int(reply["duplicates"]), int(reply.get("late", 0))
        refused = {int(each["index"]): (str(each["code"]), str(each["detail"])) for each in reply["refused"]}
    except (AttributeError, KeyError, TypeError, ValueError):
        return None
    is_complete = accepted + duplicates + len(refused) == rows and all(0 <= position < rows for position in refused)
    return BatchReply(accepted, duplicates, late, refused) if is_complete else None


def judge(problem: ProblemError, rows: int) -> tuple[BatchAction, int]:
    """Return the verdict on a batch of this many rows, and for PARTED the place of the first row at fault."""
    if problem.status == TOO_LARGE or problem.code == "batch.too_long":
        return (BatchAction.SHORTER if rows > 1 else BatchAction.WAIT), 0
    if problem.code == "plan.unknown":
        return BatchAction.NEW_PLAN, 0
    faults = [
        (str(error.get("code")), str(error.get("pointer", "")).removeprefix("#").split("/")) for error in problem.errors
    ]
    at_rows = [parts for _, parts in faults if len(parts) > 2 and parts[1] == "measurements" and parts[2].isdigit()]
    if any(code == "field.unknown" and parts[-1] in DETAIL_DECIMALS for code, parts in faults):
        return BatchAction.WITHOUT_DETAILS, 0
    positions = [int(parts[2]) for parts in at_rows if int(parts[2]) < rows]
    return (BatchAction.PARTED, min(positions)) if positions else (BatchAction.WAIT, 0)


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
