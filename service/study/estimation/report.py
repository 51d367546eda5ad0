"""Report of a campaign: tables for people.

Angles stand as yaw/roll/pitch in one cell. Numbers that are not there, or that a mean cannot hold, are a dash in a
table.
"""

import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import groupby
from typing import Any, NamedTuple

from service.study.estimation.bounds import AXES, Judged, Limit, Mark, Statistics
from service.study.estimation.campaign import METHODS, Campaign, versions
from service.study.estimation.flight.baselines import BASELINES
from service.study.estimation.flight.oracle.filter import ORACLE

MARKER_BEGIN = "<!-- soo study estimation: begin -->"
MARKER_END = "<!-- soo study estimation: end -->"
_DASH = "-"
#: columns of a page
_PAGE_WIDTH = 120
#: scenario, answer and its figures
Answer = tuple[str, str, Statistics]
#: what a column tells of an answer's figures
Cell = Callable[[Statistics], str]


class ReportTable(NamedTuple):
    """Rows under a title."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def tables(campaign: Campaign) -> tuple[ReportTable, ...]:
    """Return the tables of a campaign; what was not run has no row, a table without rows is left out."""
    made = (
        _accuracy(campaign),
        _covariance_bounds(campaign),
        _smoothed(campaign),
        _baselines(campaign),
        _control(campaign),
        _yardstick(campaign),
        _protection(campaign),
        _events(campaign),
        _bounds(campaign),
    )
    return tuple(table for table in made if table.rows)


def verdict_lines(campaign: Campaign) -> list[str]:
    """Return what was missed, in words."""
    counts = {mark: sum(judged.mark is mark for judged in campaign.judged) for mark in Mark}
    lines = [
        f"{len(campaign.judged)} bounds: " + ", ".join(f"{count} {mark}" for mark, count in counts.items() if count)
    ]
    lines += [
        f"missed: {judged.bound.scenario}, {judged.bound.method}, {judged.bound.figure} = {_number(judged.value)}, "
        f"must be {judged.bound.must}"
        for judged in campaign.missed
    ]
    lines += [
        f"goal asked for and not reached: {judged.bound.scenario}, {judged.bound.figure} = {_number(judged.value)}, "
        f"goal {judged.bound.goal}"
        for judged in campaign.judged
        if judged.bound.is_goal_asked and judged.mark is Mark.MUST
    ]
    lines += [f"refused: {run.unit.scenario}, seed {run.unit.seed}: {run.refusal}" for run in campaign.refusals]
    lines += [f"the bounds of {scenario} prove nothing: '{name}' keeps them all" for scenario, name in campaign.idle]
    return lines


def markdown(campaign: Campaign, command: str) -> str:
    """Return the tables as a section of a page, between markers."""
    made_with = ", ".join(f"{name} {number}" for name, number in versions().items())
    seeds = f"seed 1 to {campaign.plan.seeds}" if campaign.plan.seeds > 1 else "seed 1"
    made = f"Made by `{command}` with {made_with}; {seeds}; angles yaw/roll/pitch, deg."
    lines = [MARKER_BEGIN, "", *_paragraph(made), ""]
    for table in tables(campaign):
        lines += [f"### {table.title}", "", _line(table.columns), _line(["---"] * len(table.columns))]
        lines += [*(_line(row) for row in table.rows), ""]
    reported = [part for line in verdict_lines(campaign) for part in _paragraph(line, bullet="* ")]
    return "\n".join([*lines, *reported, "", MARKER_END, ""])


def _paragraph(text: str, bullet: str = "") -> list[str]:
    """Return the lines of a paragraph; a long word, such as a command, stays whole."""
    indent = " " * len(bullet)
    return textwrap.wrap(
        text,
        _PAGE_WIDTH,
        initial_indent=bullet,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _answers(campaign: Campaign, answers: Sequence[str] = METHODS) -> Iterator[Answer]:
    """Yield scenario, method and figures of everything driven."""
    for (scenario, answer), statistics in campaign.statistics.items():
        if answer in answers and "answered" in statistics:
            yield scenario, answer, statistics


def _table(title: str, answer: str, answers: Iterable[Answer], *columns: tuple[str, Cell]) -> ReportTable:
    """Return a table with a row for each answer; a column is its head and what it tells of an answer's figures."""
    rows = tuple((scenario, name, *(cell(statistics) for _, cell in columns)) for scenario, name, statistics in answers)
    return ReportTable(title, ("scenario", answer, *(head for head, _ in columns)), rows)


def _accuracy(campaign: Campaign) -> ReportTable:
    """Return the errors of both methods."""
    return _table(
        "Errors",
        "method",
        _answers(campaign, (*METHODS, ORACLE)),
        ("rms", _angles("rms_deg", 3)),
        ("p95", _angles("p95_deg", 2)),
        ("skill", _angles("skill", 2)),
        ("slope", _angles("slope", 2)),
        ("rms/sigma", _angles("rms_over_sigma", 2)),
        ("rms/oracle", _to_oracle),
    )


def _covariance_bounds(campaign: Campaign) -> ReportTable:
    """Return the errors beside the covariance of a filter that knows the true statistics."""
    return _table(
        "Covariance bounds",
        "method",
        (each for each in _answers(campaign, (*METHODS, ORACLE)) if "bound_deg.yaw" in each[2]),
        ("bound (Riccati)", _angles("bound_deg", 4)),
        ("rms", _angles("rms_deg", 4)),
        ("stated sigma", _angles("sigma_deg", 4)),
        ("pooled rms/bound", _angles("rms_over_bound", 2)),
    )


def _smoothed(campaign: Campaign) -> ReportTable:
    """Return what the smoothed answers gain over the filter on the same rows."""
    answers = (
        (scenario, answer, {key.removeprefix(name): value for key, value in statistics.items() if key.startswith(name)})
        for scenario, _, statistics in _answers(campaign, ("robust",))
        for name, answer in (("smoothed.", "whole span"), ("smoothed_2h.", "2 h of lag"))
    )
    return _table(
        "Smoothed angles",
        "smoothed by",
        (each for each in answers if "rms_deg.yaw" in each[2]),
        ("rms", _angles("rms_deg", 4)),
        ("over the filter", _angles("over_filter", 2)),
        ("rms/sigma", _angles("over_sigma", 2)),
        ("beyond 3 sigma near events", _angles("large_near_events", 4)),
        ("the same, filter", _angles("filter_large_near_events", 4)),
        ("largest without carriers", _angles("dark_deg", 3, is_optional=True)),
        ("the same, filter", _angles("filter_dark_deg", 3, is_optional=True)),
    )


def _baselines(campaign: Campaign) -> ReportTable:
    """Return the errors of the answers that need no powers; that of zero is the truth's own size."""
    rows = []
    rms = _angles("rms_deg", 3)
    for (scenario, answer), statistics in campaign.statistics.items():
        if answer == "zero":
            others = [campaign.statistics.get((scenario, name), {}) for name in (*BASELINES[1:], "robust")]
            rows.append((scenario, *map(rms, (statistics, *others)), _to_oracle(others[-1])))
    columns = (
        "scenario",
        "zero = truth",
        "corrections only",
        "coupling only",
        "corrections read",
        "robust",
        "robust/oracle",
    )
    return ReportTable("Rms of answers without powers", columns, tuple(rows))


def _control(campaign: Campaign) -> ReportTable:
    return _table(
        "Control",
        "method",
        _answers(campaign),
        ("wrong r/p, min", _figure("wrong_min.roll_pitch", 0)),
        ("wrong yaw, min", _figure("wrong_min.yaw", 0)),
        ("control in the dry", _figure("available_dry", 4)),
        ("yaw", _figure("yaw_available_dry", 3)),
        ("alarms a day", _figure("alarms_per_day", 2)),
        ("alarm after, min", _figure("alarm_delay_min", 0)),
    )


def _judged_by(campaign: Campaign, figure: str) -> Iterator[Answer]:
    """Yield scenario, answer and figures of everything that has a figure of the yardstick."""
    for (scenario, answer), statistics in campaign.statistics.items():
        if figure in statistics:
            yield scenario, answer, statistics


def _yardstick(campaign: Campaign) -> ReportTable:
    """Return how often an answer is confident and wrong, and what it pays for never being so."""
    return _table(
        "Confident and wrong: mean; worst (seed)",
        "answer",
        _judged_by(campaign, "yardstick.wrong_min"),
        ("wrong torque, min", _with_worst("wrong_min", 0)),
        ("rms", _angles("yardstick.rms_deg", 3)),
        ("worst of each axis", _angles("yardstick.rms_deg", 3, end=".worst")),
        ("rms/oracle", _to_oracle),
        ("rms/sigma roll", _with_worst("rms_over_sigma.roll", 2)),
        ("pitch", _with_worst("rms_over_sigma.pitch", 2)),
        ("control in the dry", _with_worst("allowed_dry", 3)),
    )


def _protection(campaign: Campaign) -> ReportTable:
    """Return what protection levels are worth; an answer that states none has no row."""
    return _table(
        "Protection levels: mean; worst (seed)",
        "answer",
        _judged_by(campaign, "yardstick.episodes"),
        ("misleading rows", _with_worst("misleading_share", 4)),
        ("episodes", _figure("yardstick.episodes", 0)),
        ("without level", _with_worst("without_share", 3)),
        ("median roll/pitch in the dry", _angles("yardstick.level_deg", 2, axes=AXES[1:])),
    )


def _events(campaign: Campaign) -> ReportTable:
    """Return how rain and faults were noticed; a scenario that has neither has no row."""
    delays = [_figure(name, 0) for name in ("rain_delay_median_min", "rain_delay_min")]
    return _table(
        "Rain and faults",
        "method",
        (each for each in _answers(campaign) if "rain_delay_min" in each[2] or "faults" in each[2]),
        ("rain after, min", lambda statistics: _joined([delay(statistics) for delay in delays])),
        ("covered", _figure("rain_coverage", 3)),
        ("false", _figure("rain_false_share", 4)),
        ("faults", _figure("faults", 0)),
        ("found", _figure("faults_found_share", 3)),
        ("after, min", _figure("fault_delay_median_min", 0)),
        ("false exclusion", _figure("false_exclusion_share", 4)),
    )


def _bounds(campaign: Campaign) -> ReportTable:
    """Return every bound with its mark, the axes of a figure in one row."""
    rows = []
    for (scenario, method, figure), group in groupby(campaign.judged, key=_figure_of):
        axes = list(group)
        asked = " (asked)" if any(judged.bound.is_goal_asked for judged in axes) else ""
        rows.append(
            (
                scenario,
                method,
                figure + _named_axes(axes),
                "/".join(_number(judged.value) for judged in axes),
                _joined([str(judged.bound.must or _DASH) for judged in axes]),
                _joined([str(judged.bound.goal or _DASH) for judged in axes]) + asked,
                _joined([judged.mark.value for judged in axes]),
            )
        )
    return ReportTable("Bounds", ("scenario", "method", "figure", "value", "must", "goal", "mark"), tuple(rows))


def _without_axis(figure: str) -> tuple[str, str]:
    """Return the name of a figure and its axis, empty where it has none."""
    name, _, axis = figure.rpartition(".")
    return (name, axis) if axis in AXES else (figure, "")


def _figure_of(judged: Judged) -> tuple[str, str, str]:
    return judged.bound.scenario, judged.bound.method, _without_axis(judged.bound.figure)[0]


def _named_axes(axes: Sequence[Judged]) -> str:
    """Return the names of the axes of a row, nothing where they are all three or none."""
    names = [_without_axis(judged.bound.figure)[1] for judged in axes]
    return "" if not any(names) or tuple(names) == AXES else f" {'/'.join(names)}"


def _joined(parts: Sequence[str]) -> str:
    """Return what several axes say, once where they agree; a relation that they share stands in front."""
    if len(set(parts)) == 1:
        return parts[0]
    relation, _, _ = parts[0].partition(" ")
    if all(part.startswith(f"{relation} ") for part in parts):
        return f"{relation} {'/'.join(part.partition(' ')[2] for part in parts)}"
    return "/".join(parts)


def _figure(name: str, digits: int) -> Cell:
    return lambda statistics: _number(statistics.get(name), digits)


def _angles(name: str, digits: int, axes: Sequence[str] = AXES, end: str = "", *, is_optional: bool = False) -> Cell:
    """Return the cell of a figure of several axes; an optional one is one dash where it is not there."""
    names = [f"{name}.{axis}{end}" for axis in axes]

    def cell(statistics: Statistics) -> str:
        if is_optional and names[0] not in statistics:
            return _DASH
        return "/".join(_number(statistics.get(each), digits) for each in names)

    return cell


def _with_worst(name: str, digits: int) -> Cell:
    """Return the cell of a figure of the yardstick: mean, worst and the worst seed."""

    def cell(statistics: Statistics) -> str:
        mean, worst, seed = (statistics.get(f"yardstick.{name}{end}") for end in ("", ".worst", ".worst_seed"))
        return _DASH if mean is None else f"{_number(mean, digits)}; {_number(worst, digits)} ({_number(seed, 0)})"

    return cell


#: ratio of an answer's errors to the oracle's, where there is one
_to_oracle = _angles("rms_over_oracle", 2, is_optional=True)


def _number(value: float | None, digits: int | None = None) -> str:
    """Return a number with some decimals, or with as many up to four as it needs."""
    if value is None or math.isnan(value):
        return _DASH
    if math.isinf(value):
        return "never" if value > 0 else _DASH
    # large numbers are those of answers that failed: their decimals say nothing
    large = (abs(value) >= 10.0) + (abs(value) >= 100.0)
    text = f"{value:.{max(0, (4 if digits is None else digits) - large)}f}"
    text = text.rstrip("0").rstrip(".") if digits is None and "." in text else text
    # what rounds to nothing has no sign
    return text.lstrip("-") if float(text) == 0.0 else text


def as_document(campaign: Campaign, command: str) -> dict[str, Any]:
    """Return everything a program may want, fit for JSON."""
    plan = campaign.plan
    statistics: dict[str, dict[str, dict[str, float | None]]] = {}
    for (scenario, answer), reported in campaign.statistics.items():
        statistics.setdefault(scenario, {})[answer] = {name: _finite(value) for name, value in reported.items()}
    return {
        "command": command,
        "versions": versions(),
        "seeds": list(range(1, plan.seeds + 1)),
        "operation_days": plan.operation_days,
        "seconds": round(campaign.seconds, 1),
        "figures": statistics,
        "bounds": [_bound_document(judged) for judged in campaign.judged],
        "missed": len(campaign.missed),
        "refusals": [
            {"scenario": run.unit.scenario, "seed": run.unit.seed, "detail": run.refusal} for run in campaign.refusals
        ],
        "baselines_that_keep_all_bounds": [
            {"scenario": scenario, "baseline": baseline} for scenario, baseline in campaign.idle
        ],
    }


def _bound_document(judged: Judged) -> dict[str, Any]:
    bound = judged.bound
    return {
        "scenario": bound.scenario,
        "method": bound.method,
        "figure": bound.figure,
        "value": None if judged.value is None else _finite(judged.value),
        "must": _interval(bound.must),
        "goal": _interval(bound.goal),
        "goal_asked": bound.is_goal_asked,
        "source": bound.source,
        "mark": judged.mark.value,
    }


def _interval(limit: Limit | None) -> list[float | None] | None:
    """Return a limit as its two ends, None for an open one."""
    return None if limit is None else [_finite(limit.low), _finite(limit.high)]


def _finite(value: float) -> float | None:
    """Return a number that JSON can hold."""
    return value if math.isfinite(value) else None
