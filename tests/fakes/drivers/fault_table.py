"""What can go wrong between front end and analyzer, and what must come of it: the table of the how-to as data."""

from typing import NamedTuple


class FaultRow(NamedTuple):
    """One fault and its outcome."""

    fault: str
    outcome: str
    #: rows that may be missing
    lost: int
    #: whether another session is opened
    is_reopened: bool
    #: flag of a row that carries no levels, or that was taken again
    flag: str = ""


_REOPENED = "session closed, another one opened, next row `RECONNECTED`"
_NO_LEVEL = "spoiled carriers null, `NONFINITE_VALUE`"
_RESTORED = "settings restored, sweep taken again, `SETTING_MISMATCH`"

TABLE: tuple[FaultRow, ...] = (
    FaultRow("connection reset", _REOPENED, 1, is_reopened=True),
    FaultRow("connection closed", _REOPENED, 1, is_reopened=True),
    FaultRow("no answer", _REOPENED, 1, is_reopened=True),
    FaultRow("garbage", _REOPENED, 1, is_reopened=True),
    FaultRow("reset in a block", _REOPENED, 1, is_reopened=True),
    FaultRow("half a block", _REOPENED, 1, is_reopened=True),
    FaultRow("stale answer", _REOPENED, 1, is_reopened=True),
    FaultRow("late answer", _REOPENED, 1, is_reopened=True),
    FaultRow("silent peer", _REOPENED, 2, is_reopened=True),
    FaultRow("analyzer off and on", _REOPENED, 2, is_reopened=True),
    FaultRow("one value missing", _REOPENED, 1, is_reopened=True),
    FaultRow("one value too many", _REOPENED, 1, is_reopened=True),
    FaultRow("no value at all", _REOPENED, 1, is_reopened=True),
    FaultRow("trace in dBuV", _REOPENED, 1, is_reopened=True),
    FaultRow("trace in W", _REOPENED, 1, is_reopened=True),
    FaultRow("NaN", _NO_LEVEL, 0, is_reopened=False, flag="NONFINITE_VALUE"),
    FaultRow("-999", _NO_LEVEL, 0, is_reopened=False, flag="NONFINITE_VALUE"),
    FaultRow("9.91E37", _NO_LEVEL, 0, is_reopened=False, flag="NONFINITE_VALUE"),
    FaultRow("9.9E37", _NO_LEVEL, 0, is_reopened=False, flag="NONFINITE_VALUE"),
    FaultRow("unit changed by another client", _RESTORED, 0, is_reopened=False, flag="SETTING_MISMATCH"),
    FaultRow("span changed by another client", _RESTORED, 0, is_reopened=False, flag="SETTING_MISMATCH"),
    FaultRow("reset by another client", _RESTORED, 0, is_reopened=False, flag="SETTING_MISMATCH"),
    FaultRow("device clear in mid-sweep", _REOPENED, 1, is_reopened=True),
)


def markdown_table() -> str:
    """Return the table as it stands in the how-to."""
    head = "| fault | what happens | rows lost |\n|---|---|---|"
    rows = [f"| {row.fault} | {row.outcome} | {row.lost or 'none'} |" for row in TABLE]
    return "\n".join([head, *rows])
