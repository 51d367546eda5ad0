"""All tables of the study, for people and for programs."""

import math
import time
from typing import Any, NamedTuple

from service.study.limit_cycles.capture_tables import band_table, capture_table, perpetual_table
from service.study.limit_cycles.comparison import Compared, ComparedTable
from service.study.limit_cycles.cycle_tables import both_lines_table, limit_cycle_table, succession_table
from service.study.limit_cycles.schedule_table import schedule_table

COLUMNS = ("case", "figure", "reference", "reproduced", "ratio", "kept")
_TABLES = (
    limit_cycle_table,
    succession_table,
    capture_table,
    band_table,
    perpetual_table,
    schedule_table,
    both_lines_table,
)


class Reproduction(NamedTuple):
    """Every table, and how long they took."""

    tables: tuple[ComparedTable, ...]
    seconds: float

    @property
    def missed(self) -> tuple[tuple[str, Compared], ...]:
        """Return the figures outside their tolerance with the names of their tables."""
        return tuple((table.name, row) for table in self.tables for row in table.rows if not row.is_kept)


def reproduce() -> Reproduction:
    """Return all tables of the study."""
    began = time.monotonic()
    made = tuple(table() for table in _TABLES)
    return Reproduction(made, time.monotonic() - began)


def cells(row: Compared) -> tuple[str, ...]:
    """Return one figure as the cells of a line."""
    ratio = f"{row.ratio:.9f}" if math.isfinite(row.ratio) else "-"
    return (
        row.case,
        row.figure,
        f"{row.reference:.10g}",
        f"{row.found:.10g}",
        ratio,
        "yes" if row.is_kept else "no",
    )


def summary_lines(done: Reproduction) -> list[str]:
    """Return counts, what was missed, and the time, in words."""
    count = sum(len(table.rows) for table in done.tables)
    lines = [f"{count} figures, {count - len(done.missed)} within their tolerance, {done.seconds:.1f} s"]
    lines += [
        f"missed: {name}, {row.case}, {row.figure}: {row.found:.10g}, reference {row.reference:.10g}"
        for name, row in done.missed
    ]
    return lines


def markdown(done: Reproduction) -> str:
    """Return the tables as sections of a page."""
    lines = []
    for table in done.tables:
        lines += [f"### {table.name} {table.title}", "", _line(COLUMNS), _line(("---",) * len(COLUMNS))]
        lines += [*(_line(cells(row)) for row in table.rows), ""]
    lines += [f"* {line}" for line in summary_lines(done)]
    return "\n".join([*lines, ""])


def as_document(done: Reproduction) -> dict[str, Any]:
    """Return everything a program may want, fit for JSON; infinite and missing numbers are null."""
    return {
        "seconds": round(done.seconds, 2),
        "missed": len(done.missed),
        "tables": {
            table.name: {"title": table.title, "rows": [_row_document(row) for row in table.rows]}
            for table in done.tables
        },
    }


def _row_document(row: Compared) -> dict[str, Any]:
    """Return one figure."""
    return {
        "case": row.case,
        "figure": row.figure,
        "reference": _finite(row.reference),
        "found": _finite(row.found),
        "ratio": _finite(row.ratio),
        "tolerance": row.tolerance,
        "tolerance_is_relative": row.is_relative,
        "kept": row.is_kept,
    }


def _finite(value: float) -> float | None:
    """Return a number that JSON can hold."""
    return value if math.isfinite(value) else None


def _line(line_cells: tuple[str, ...]) -> str:
    """Return one line of a table in Markdown."""
    return f"| {' | '.join(line_cells)} |"
