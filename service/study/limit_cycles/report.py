"""All tables of the study, for people and for programs.

T6: torque schedules.
"""

import math
import time
from typing import Any, NamedTuple

import numpy as np

from service.core.flexible.schedule import FREQUENCY_COUNT, FREQUENCY_REACH, TorquePulse, schedule_response
from service.core.flexible.spacecraft import HubMode
from service.study.limit_cycles import reference
from service.study.limit_cycles.reference import Compared, ComparedTable
from service.study.limit_cycles.tables import (
    band_table,
    both_lines_table,
    capture_table,
    limit_cycle_table,
    perpetual_table,
    succession_table,
)


def schedules() -> dict[str, tuple[TorquePulse, ...]]:
    """Return the schedules of T6 by name."""
    _, (omega, xi, _), torque, width = reference.SCHEDULE_AXIS
    period_s = 2.0 * math.pi / omega
    half_s = math.pi / (omega * math.sqrt(1.0 - xi * xi))
    intervals = {"ten a period": period_s, "ten a half period": 0.5 * period_s, "ten every 10 s": 10.0}
    made: dict[str, tuple[TorquePulse, ...]] = {"single": (TorquePulse(0.0, width, torque),)}
    made |= {name: tuple(TorquePulse(k * apart, width, torque) for k in range(10)) for name, apart in intervals.items()}
    made["two halves"] = tuple(TorquePulse(k * half_s, width, 0.5 * torque) for k in range(2))
    return made


def schedule_table() -> ComparedTable:
    """Return T6."""
    inertia, mode_numbers, _, _ = reference.SCHEDULE_AXIS
    mode = HubMode(*mode_numbers)
    tried = mode.omega_rad_s * np.linspace(1.0 - FREQUENCY_REACH, 1.0 + FREQUENCY_REACH, FREQUENCY_COUNT)
    rows = []
    for name, pulses in schedules().items():
        nominal = schedule_response(pulses, mode, inertia)
        scanned = schedule_response(pulses, mode, inertia, omega_rad_s=tried)
        found = {
            "peak": nominal.peak_rad[0],
            "residual": nominal.residual_rad[0],
            "scanned peak": scanned.peak_rad.max(),
            "scanned residual": scanned.residual_rad.max(),
        }
        # the residual of two halves is printed with five digits
        rows += [
            Compared(name, f"{figure}, rad", printed, float(found[figure]), 1e-6 if "halves" not in name else 4e-5)
            for figure, printed in reference.SCHEDULES[name].items()
        ]
    return ComparedTable("T6", "Torque schedules", tuple(rows))


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
