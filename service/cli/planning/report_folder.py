"""Folder of a report: Markdown, the document as JSON, the map of the stations and the figure of the quiet days."""

import json
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from service.cli.planning.figures import draw_planning, draw_quiet_days
from service.cli.planning.report import planning_parts
from service.cli.planning.sources import CarrierPlanning


def write_report(planning: CarrierPlanning, folder: Path) -> None:
    """Write ``report.md``, ``plan.json``, ``stations.png`` and, of quiet days, ``quiet-days.png``."""
    folder.mkdir(parents=True, exist_ok=True)
    draw_planning(planning, folder / "stations.png")
    parts = [_markdown(part) for part in planning_parts(planning)]
    parts.insert(1, "![Stations in the antenna frame](stations.png)\n")
    if planning.rehearsal is not None:
        draw_quiet_days(planning, planning.rehearsal, folder / "quiet-days.png")
        parts.insert(1, "![Allan deviation, daily change and the rehearsed angles](quiet-days.png)\n")
    (folder / "report.md").write_text(f"# Plan of {planning.name}\n\n" + "\n".join(parts), encoding="utf-8")
    (folder / "plan.json").write_text(json.dumps(planning.document, allow_nan=False, indent=1), encoding="utf-8")


def _markdown(part: str | Table) -> str:
    """Return a line or a table as Markdown."""
    if isinstance(part, str):
        return f"* {part.strip()}\n" if part.startswith("  ") else part + ("" if part.startswith("*") else "\n")
    header = [str(column.header) for column in part.columns]
    rows = zip(*(column.cells for column in part.columns), strict=True)
    lines = [f"\n## {part.title}\n", _line(header), _line(["---"] * len(header)), *(_line(row) for row in rows)]
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[object]) -> str:
    """Return one line of a table."""
    return f"| {' | '.join(str(cell).replace('|', '/') for cell in cells)} |"
