"""Report of a campaign: tables for people.

Angles stand as yaw/roll/pitch in one cell. Numbers that are not there, or that a mean cannot hold, are a dash in a
table.
"""

import math
import textwrap
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

from service.study.estimation.bounds import AXES, Judged, Mark, Statistics
from service.study.estimation.campaign import METHODS, Campaign, versions
from service.study.estimation.flight.baselines import BASELINES
from service.study.estimation.flight.oracle.filter import ORACLE

MARKER_BEGIN = "<!-- soo study estimation: begin -->"
MARKER_END = "<!-- soo study estimation: end -->"
_DASH = "-"
#: columns of a page
_PAGE_WIDTH = 120


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
    """Return one line of a table in Markdown."""
    return f"| {' | '.join(cells)} |"


def _answers(campaign: Campaign, answers: Sequence[str] = METHODS) -> Iterator[tuple[str, str, Statistics]]:
    """Yield scenario, method and figures of everything driven."""
    for (scenario, answer), statistics in campaign.statistics.items():
        if answer in answers and "answered" in statistics:
            yield scenario, answer, statistics


def _accuracy(campaign: Campaign) -> ReportTable:
    """Return the errors of both methods."""
    rows = tuple(
        (
            scenario,
            method,
            _angles(statistics, "rms_deg", 3),
            _angles(statistics, "p95_deg", 2),
            _angles(statistics, "skill", 2),
            _angles(statistics, "slope", 2),
            _angles(statistics, "rms_over_sigma", 2),
            _to_oracle(statistics),
        )
        for scenario, method, statistics in _answers(campaign, (*METHODS, ORACLE))
    )
    columns = ("scenario", "method", "rms", "p95", "skill", "slope", "rms/sigma", "rms/oracle")
    return ReportTable("Errors", columns, rows)


def _covariance_bounds(campaign: Campaign) -> ReportTable:
    """Return the errors beside the covariance of a filter that knows the true statistics."""
    rows = tuple(
        (
            scenario,
            method,
            _angles(statistics, "bound_deg", 4),
            _angles(statistics, "rms_deg", 4),
            _angles(statistics, "sigma_deg", 4),
            _angles(statistics, "rms_over_bound", 2),
        )
        for scenario, method, statistics in _answers(campaign, (*METHODS, ORACLE))
        if "bound_deg.yaw" in statistics
    )
    columns = ("scenario", "method", "bound (Riccati)", "rms", "stated sigma", "pooled rms/bound")
    return ReportTable("Covariance bounds", columns, rows)


def _smoothed(campaign: Campaign) -> ReportTable:
    """Return what the smoothed answers gain over the filter on the same rows."""
    rows = tuple(
        (
            scenario,
            answer,
            _angles(statistics, f"{name}.rms_deg", 4),
            _angles(statistics, f"{name}.over_filter", 2),
            _angles(statistics, f"{name}.over_sigma", 2),
            _angles(statistics, f"{name}.large_near_events", 4),
            _angles(statistics, f"{name}.filter_large_near_events", 4),
            *(
                _angles(statistics, f"{name}.{kind}", 3) if f"{name}.{kind}.yaw" in statistics else _DASH
                for kind in ("dark_deg", "filter_dark_deg")
            ),
        )
        for scenario, _, statistics in _answers(campaign, ("robust",))
        for name, answer in (("smoothed", "whole span"), ("smoothed_2h", "2 h of lag"))
        if f"{name}.rms_deg.yaw" in statistics
    )
    columns = (
        "scenario",
        "smoothed by",
        "rms",
        "over the filter",
        "rms/sigma",
        "beyond 3 sigma near events",
        "the same, filter",
        "largest without carriers",
        "the same, filter",
    )
    return ReportTable("Smoothed angles", columns, rows)


def _baselines(campaign: Campaign) -> ReportTable:
    """Return the errors of the answers that need no powers; that of zero is the truth's own size."""
    rows = []
    for (scenario, answer), statistics in campaign.statistics.items():
        if answer == "zero":
            others = [campaign.statistics.get((scenario, name), {}) for name in (*BASELINES[1:], "robust")]
            rms = [_angles(answer, "rms_deg", 3) for answer in (statistics, *others)]
            rows.append((scenario, *rms, _to_oracle(others[-1])))
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
    """Return what control would have done."""
    rows = tuple(
        (
            scenario,
            method,
            _number(statistics.get("wrong_min.roll_pitch"), 0),
            _number(statistics.get("wrong_min.yaw"), 0),
            _number(statistics.get("available_dry"), 4),
            _number(statistics.get("yaw_available_dry"), 3),
            _number(statistics.get("alarms_per_day"), 2),
            _number(statistics.get("alarm_delay_min"), 0),
        )
        for scenario, method, statistics in _answers(campaign)
    )
    columns = (
        "scenario",
        "method",
        "wrong r/p, min",
        "wrong yaw, min",
        "control in the dry",
        "yaw",
        "alarms a day",
        "alarm after, min",
    )
    return ReportTable("Control", columns, rows)


def _yardstick(campaign: Campaign) -> ReportTable:
    """Return how often an answer is confident and wrong, and what it pays for never being so."""
    rows = tuple(
        (
            scenario,
            answer,
            _with_worst(statistics, "wrong_min", 0),
            _angles(statistics, "yardstick.rms_deg", 3),
            "/".join(_number(statistics.get(f"yardstick.rms_deg.{axis}.worst"), 3) for axis in AXES),
            _to_oracle(statistics),
            *(_with_worst(statistics, f"rms_over_sigma.{axis}", 2) for axis in AXES[1:]),
            _with_worst(statistics, "allowed_dry", 3),
        )
        for (scenario, answer), statistics in campaign.statistics.items()
        if "yardstick.wrong_min" in statistics
    )
    columns = (
        "scenario",
        "answer",
        "wrong torque, min",
        "rms",
        "worst of each axis",
        "rms/oracle",
        "rms/sigma roll",
        "pitch",
        "control in the dry",
    )
    return ReportTable("Confident and wrong: mean; worst (seed)", columns, rows)


def _protection(campaign: Campaign) -> ReportTable:
    """Return what protection levels are worth; an answer that states none has no row."""
    rows = tuple(
        (
            scenario,
            answer,
            _with_worst(statistics, "misleading_share", 4),
            _number(statistics["yardstick.episodes"], 0),
            _with_worst(statistics, "without_share", 3),
            "/".join(_number(statistics.get(f"yardstick.level_deg.{axis}"), 2) for axis in AXES[1:]),
        )
        for (scenario, answer), statistics in campaign.statistics.items()
        if "yardstick.episodes" in statistics
    )
    columns = ("scenario", "answer", "misleading rows", "episodes", "without level", "median roll/pitch in the dry")
    return ReportTable("Protection levels: mean; worst (seed)", columns, rows)


def _with_worst(statistics: Statistics, name: str, digits: int) -> str:
    """Return a figure of the yardstick: mean, worst and the worst seed."""
    mean, worst, seed = (statistics.get(f"yardstick.{name}{end}") for end in ("", ".worst", ".worst_seed"))
    return _DASH if mean is None else f"{_number(mean, digits)}; {_number(worst, digits)} ({_number(seed, 0)})"


def _events(campaign: Campaign) -> ReportTable:
    """Return how rain and faults were noticed; a scenario that has neither has no row."""
    rows = tuple(
        (
            scenario,
            method,
            _joined([_number(statistics.get(name), 0) for name in ("rain_delay_median_min", "rain_delay_min")]),
            _number(statistics.get("rain_coverage"), 3),
            _number(statistics.get("rain_false_share"), 4),
            _number(statistics.get("faults"), 0),
            _number(statistics.get("faults_found_share"), 3),
            _number(statistics.get("fault_delay_median_min"), 0),
            _number(statistics.get("false_exclusion_share"), 4),
        )
        for scenario, method, statistics in _answers(campaign)
        if "rain_delay_min" in statistics or "faults" in statistics
    )
    columns = (
        "scenario",
        "method",
        "rain after, min",
        "covered",
        "false",
        "faults",
        "found",
        "after, min",
        "false exclusion",
    )
    return ReportTable("Rain and faults", columns, rows)


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
    """Return what the axes of one figure have in common."""
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


def _angles(statistics: Statistics, name: str, digits: int) -> str:
    """Return a figure of the three axes."""
    return "/".join(_number(statistics.get(f"{name}.{axis}"), digits) for axis in AXES)


def _to_oracle(statistics: Statistics) -> str:
    """Return the ratio of an answer's errors to the oracle's, where there is one."""
    return _angles(statistics, "rms_over_oracle", 2) if "rms_over_oracle.yaw" in statistics else _DASH


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
