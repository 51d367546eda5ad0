"""The report of ``soo plan``: verdict, tables of the sets, the carriers, averages and turns, for people."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from service.cli.planning.figures import draw_planning, draw_quiet_days
from service.cli.planning.sources import CarrierPlanning

_AXES = ("yaw", "roll", "pitch")
_SETS = ("optimal", "paper", "all")
#: deg, a bound beyond this says that the axis is not seen
_UNSEEN_DEG = 90.0


def print_planning(console: Console, planning: CarrierPlanning) -> None:
    """Print everything that a planning says."""
    for part in planning_parts(planning):
        console.print(part, highlight=False)


def planning_parts(planning: CarrierPlanning) -> Iterator[str | Table]:
    """Yield everything that a planning says, lines and tables."""
    document, quiet = planning.document, planning.document.get("quiet")
    origin = (
        f"calibration {document['calibration_id']} ({document['calibration_method']})"
        if document["calibration_id"] is not None
        else "assumed beams, nothing calibrated"
    )
    yield f"{planning.name}: {len(document['carriers'])} carriers by {origin}, rule {document['rule']}"
    if quiet is not None:
        yield quiet["verdict"]
    yield from (f"* {note}" for note in document["notes"])
    if quiet is not None:
        yield _prediction_table(quiet)
        yield _quiet_table(quiet)
    yield _sets_table(document)
    yield _averages_table(document)
    if document.get("momentum") is not None:
        yield _momentum_table(document["momentum"])
    if document.get("measured_motion") is not None:
        yield _motion_table(document["measured_motion"])
    yield _chosen_table(document)
    left = [row for row in document["carriers"] if not row["selected"]]
    if left:
        yield "Left out"
        yield from (f"  {row['carrier']}: {'; '.join(row['reasons'])}" for row in left)
    yield from (f"not sufficient: {shortcoming}" for shortcoming in document["shortcomings"])
    if document["further"]:
        yield _further_table(document["further"])
    if document["turns"] is not None:
        yield _turns_table(document["turns"])


def _prediction_table(quiet: dict[str, Any]) -> Table:
    title = f"Expected after the turns, by a rehearsal over {quiet['days']:.1f} quiet days ({quiet['rows']} rows)"
    table = Table("deg", *_AXES, title=title, title_justify="left")
    for name, field in (
        ("sigma", "sigma_deg"),
        ("protection level, usual", "protection_deg"),
        ("protection level, 95 % of the rows", "protection_95_deg"),
        ("rms of the angles over the quiet days", "departure_deg"),
    ):
        table.add_row(name, *(_angle(quiet[field][axis]) for axis in _AXES))
    return table


def _quiet_table(quiet: dict[str, Any]) -> Table:
    """Return what the quiet days show of each carrier."""
    spans = [_span(one["span_s"]) for one in quiet["carriers"][0]["allan_db"]]
    columns = ("carrier", "usable", "there", "daily, dB", "law", "rms, dB", *spans)
    title = "Carriers: daily change with its fit, Allan deviation in dB by averaging time"
    table = Table(*columns, title=title, title_justify="left")
    for row in quiet["carriers"]:
        change = row["daily_change"]
        usable = "yes" if row["usable"] else f"no: {'; '.join(row['reasons'])}"
        fit = (_number(change["amplitude_db"], 3), change["law"].replace("_", " "), _number(change["rms_db"], 3))
        allan = (_number(one["deviation_db"], 3) for one in row["allan_db"])
        table.add_row(row["carrier"], usable, f"{row['present_share']:.1%}", *fit, *allan)
    return table


def _further_table(further: list[dict[str, Any]]) -> Table:
    """Return the further carriers that would help most."""
    title = "Further carriers that would help most, one after the other"
    table = Table("carrier", "transponder", *(f"bound of {axis}" for axis in _AXES), title=title, title_justify="left")
    for one in further:
        name = one["carrier"] if one["in_plan"] else f"a user near {one['carrier']}"
        ratios = (one["bound_ratio"][axis] for axis in _AXES)
        table.add_row(name, one["transponder"], *("-" if r is None else f"{r - 1.0:+.0%}" for r in ratios))
    return table


def _sets_table(document: dict[str, Any]) -> Table:
    """Return the observability by each set, one figure a line."""
    sets = [document["sets"][name] for name in _SETS]
    table = Table("one row, level common to all carriers free", *_SETS, title="Sets of carriers", title_justify="left")
    table.add_row("carriers", *(str(len(one["selected"])) for one in sets))
    table.add_row("condition", *(_number(one["condition"], 1) for one in sets))
    table.add_row("DOP yaw / roll / pitch, deg/dB", *(_angles(one["dop"]) for one in sets))
    table.add_row("angle DOP, deg/dB", *(_number(one["angle_dop"], 2) for one in sets))
    table.add_row("CRLB yaw / roll / pitch, deg", *(_angles(one["crlb_deg"]) for one in sets))
    table.add_row("CRLB, common level known, deg", *(_angles(one["crlb_without_common_deg"]) for one in sets))
    table.add_row("rain that looks like a turn, share", *(_number(one["common_share"], 2) for one in sets))
    table.add_row("redundancy", *(str(one["redundancy"]) for one in sets))
    table.add_row("fullest transponder, share", *(_number(one["transponder_share"], 2) for one in sets))
    table.add_row("greatest leverage", *(_greatest(one, "leverage", 2) for one in sets))
    table.add_row("largest undetectable fault, dB", *(_greatest(one, "undetectable_fault_db", 2) for one in sets))
    table.add_row("sufficient", *("yes" if one["sufficient"] else "no" for one in sets))
    return table


def _averages_table(document: dict[str, Any]) -> Table:
    """Return the sigmas after averaging by the noise that was learned or assumed."""
    sets = [document["sets"][name] for name in _SETS]
    title = "Sigma of yaw / roll / pitch from powers alone, deg"
    table = Table("average over", *_SETS, title=title, title_justify="left")
    table.add_row("1 row", *(_angles(one["crlb_deg"]) for one in sets))
    for k, first in enumerate(sets[0]["averaged"]):
        table.add_row(_span(first["span_s"]), *(_angles(one["averaged"][k]["sigma_deg"]) for one in sets))
    return table


def _momentum_table(gain: dict[str, Any]) -> Table:
    """Return what the momentum of the wheels would give."""
    title = (
        f"Bound over a day, one sigma, deg; wheels of {gain['pitch_bias_n_m_s']:g} N m s along pitch, read to "
        f"{gain['sigma_n_m_s']:g} N m s each {_span(gain['period_s'])}"
    )
    table = Table("by", *_AXES, title=title, title_justify="left")
    table.add_row("powers", *(_angle(gain["without_deg"][axis]) for axis in _AXES))
    table.add_row("powers and momentum", *(_angle(gain["with_deg"][axis]) for axis in _AXES))
    return table


def _motion_table(gain: dict[str, Any]) -> Table:
    """Return what the rate sensor and the polarimeters of the catalogue would give."""
    title = "Bound over a day, one sigma, deg; what measures motion by the catalogue"
    table = Table("by", *_AXES, title=title, title_justify="left")
    for name, field in (
        ("powers", "powers_deg"),
        ("powers and rates", "rates_deg"),
        ("powers and polarisation", "polarization_deg"),
        ("all, wheels included", "all_deg"),
    ):
        if gain[field] is not None:
            table.add_row(name, *(_angle(gain[field][axis]) for axis in _AXES))
    return table


def _chosen_table(document: dict[str, Any]) -> Table:
    """Return the carriers of the set that the rule chose, in the order of choice."""
    columns = (
        "carrier",
        "transponder",
        "yaw",
        "roll",
        "pitch",
        "sigma, dB",
        "leverage",
        "hidden fault, dB",
        "moves, deg",
    )
    table = Table(*columns, title=f"Chosen by rule {document['rule']}; slopes in dB/deg", title_justify="left")
    known = {row["carrier"]: row for row in document["carriers"]}
    for member in document["sets"][document["rule"]]["carriers"]:
        row = known[member["carrier"]]
        slopes = (f"{row['sensitivity_db_per_deg'][axis]:+.2f}" for axis in _AXES)
        figures = (_number(row["sigma_db"], 2), _number(member["leverage"], 2), _fault(member))
        table.add_row(row["carrier"], row["transponder"], *slopes, *figures, _angles(member["fault_shift_deg"]))
    return table


def _turns_table(turns: dict[str, Any]) -> Table:
    title = f"Recommended turns, {turns['total_s'] / 3600.0:.1f} h in all"
    table = Table("start", "minutes", "yaw, deg", "roll, deg", "pitch, deg", title=title, title_justify="left")
    for step in turns["steps"]:
        angles = (f"{step[f'{axis}_deg']:+.3f}" if step[f"{axis}_deg"] else "0" for axis in _AXES)
        table.add_row(step.get("start", _offset(step["offset_s"])), f"{step['duration_s'] / 60.0:.0f}", *angles)
    return table


def _offset(offset_s: float) -> str:
    """Return a time from the start of the turns as +h:mm."""
    minutes = round(offset_s / 60.0)
    return f"+{minutes // 60}:{minutes % 60:02d}"


def _span(span_s: float) -> str:
    """Return a span in hours or minutes."""
    return f"{span_s / 3600.0:g} h" if span_s >= 3600.0 else f"{span_s / 60.0:g} min"


def _number(value: float | None, digits: int) -> str:
    """Return a figure; a dash where there is none."""
    return "-" if value is None else f"{value:.{digits}f}"


def _angles(angles: dict[str, float | None]) -> str:
    """Return three angles; an axis that is not seen says so."""
    return " / ".join(_angle(angles[axis]) for axis in _AXES)


def _angle(value: float | None) -> str:
    """Return one angle with three digits, fewer where it is large."""
    if value is None or abs(value) > _UNSEEN_DEG:
        return "unseen"
    return f"{value:.3f}" if abs(value) < 10.0 else f"{value:.1f}"


def _greatest(one: dict[str, Any], name: str, digits: int) -> str:
    """Return the greatest figure among the carriers of a set, and whose it is."""
    carriers = one["carriers"]
    if name == "undetectable_fault_db" and any(_is_unchecked(carrier) for carrier in carriers):
        return f"any ({next(carrier['carrier'] for carrier in carriers if _is_unchecked(carrier))})"
    known = [carrier for carrier in carriers if carrier[name] is not None]
    if not known:
        return "-"
    greatest = max(known, key=lambda carrier: float(carrier[name]))
    return f"{greatest[name]:.{digits}f} ({greatest['carrier']})"


def _is_unchecked(member: dict[str, Any]) -> bool:
    """Return whether no other carrier checks one: its leverage is known, the bound of its fault is not finite."""
    return member["leverage"] is not None and member["undetectable_fault_db"] is None


def _fault(member: dict[str, Any]) -> str:
    """Return the largest fault that stays hidden."""
    return "any" if _is_unchecked(member) else _number(member["undetectable_fault_db"], 2)


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
    return f"| {' | '.join(str(cell).replace('|', '/') for cell in cells)} |"
