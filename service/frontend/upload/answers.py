"""Answers of the service to a batch: rows accounted for, and the action after a batch refused as a whole.

::

    problem                                             verdict
    413, or 422 batch.too_long                          SHORTER          half as many rows a request
    422 field.unknown at a figure beside the powers     WITHOUT_DETAILS  the service does not know it: leave them out
    422 that points at a row                            PARTED           rows before it alone, then it alone is refused
    404 plan.unknown                                    NEW_PLAN         fetch the plan, wait, send again
    anything else (401, 403, 404, 409, 422)             WAIT             wait, send again
"""

from enum import Enum, auto
from typing import Any, NamedTuple

from service.client.problem import ProblemError

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
