"""Figures of a campaign: errors over time with the sigma that was stated, and all scenarios side by side."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from service.pipeline.config import InterlockConfig
from service.records.levels.attitude import FloatArray
from service.study.estimation.accuracy import AXES
from service.study.estimation.baselines import BASELINES
from service.study.estimation.campaign import METHODS, Campaign
from service.study.estimation.unit import Course, UnitResult

_COLORS = {
    "robust": "#1f77b4",
    "paper": "#ff7f0e",
    "zero": "#555555",
    "corrections": "#9467bd",
    "coupling": "#2ca02c",
    "corrections_read": "#8c564b",
}
_MARKERS = {"zero": "x", "corrections": "+", "coupling": "1", "corrections_read": "2"}
#: half the height of a plot of errors, yaw, roll, pitch, deg: larger errors leave it, so that the others are seen
_REACH_DEG = (0.5, 0.15, 0.15)
#: greatest error and level of a Stanford diagram, deg; what is greater stands at the edge
_STANFORD_DEG = 0.4
ALERT_DEG = InterlockConfig().alert_limit_deg


def draw_campaign(campaign: Campaign, folder: Path) -> list[Path]:
    """Draw the first seed of every scenario and the overview; return the files."""
    first: dict[str, UnitResult] = {}
    for result in campaign.results:
        if result.course is not None:
            first.setdefault(result.unit.scenario, result)
    paths = []
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        for scenario, result in first.items():
            if result.course is not None:
                paths.append(folder / f"{scenario}.png")
                _draw_errors(result.course, f"{scenario}, seed {result.unit.seed}", paths[-1])
        for scenario in first:
            answers = _with_levels(campaign, scenario)
            if answers:
                paths.append(folder / f"stanford_{scenario}.png")
                _draw_stanford(answers, scenario, paths[-1])
        scenarios = [name for name in first if (name, "zero") in campaign.statistics]
        if scenarios:
            paths.append(folder / "overview.png")
            _draw_overview(campaign, scenarios, paths[-1])
    return paths


def _draw_errors(course: Course, title: str, path: Path) -> None:
    """Draw the error of every method, axis by axis, over twice its own sigma."""
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    plots: Sequence[Axes] = figure.subplots(3, 1, sharex=True)
    for k, (axis, plot) in enumerate(zip(AXES, plots, strict=True)):
        for method in reversed(METHODS):
            if method not in course.methods:
                continue
            drawn, color = course.methods[method], _COLORS[method]
            band = 2.0 * drawn.sigma_deg[:, k]
            plot.fill_between(course.hours, -band, band, color=color, alpha=0.12, linewidth=0.0)
            error = drawn.estimate_deg[:, k] - course.truth_deg[:, k]
            plot.plot(course.hours, error, color=color, linewidth=0.9, label=f"{method}, band 2 sigma")
            if method == "robust":
                held = np.where(drawn.is_control_allowed, np.nan, -_REACH_DEG[k])
                plot.plot(course.hours, held, color="#d62728", linewidth=4.0, label="no control (robust)")
        plot.set_ylim(-_REACH_DEG[k], _REACH_DEG[k])
        plot.set_ylabel(f"{axis} error, deg")
    plots[-1].set_xlabel("hours of operation")
    figure.suptitle(title)
    figure.legend(*plots[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(path, dpi=110)


def _with_levels(campaign: Campaign, scenario: str) -> list[tuple[FloatArray, FloatArray]]:
    """Return absolute errors and protection levels (T, 3) of the robust method in each seed that states levels."""
    courses = [one.course for one in campaign.results if one.unit.scenario == scenario]
    drawn = [(one.methods["robust"], one.truth_deg) for one in courses if one is not None and "robust" in one.methods]
    return [
        (np.abs(each.estimate_deg - truth_deg), np.asarray(each.protection_deg, dtype=np.float64))
        for each, truth_deg in drawn
        if each.protection_deg is not None
    ]


def _draw_stanford(answers: Sequence[tuple[FloatArray, FloatArray]], scenario: str, path: Path) -> None:
    """Draw how many rows have which error and which protection level."""
    figure = Figure(figsize=(8.0, 4.4), layout="constrained")
    plots: Sequence[Axes] = figure.subplots(1, 2, sharey=True)
    edges = np.linspace(0.0, _STANFORD_DEG, 81)
    for k, plot in zip((1, 2), plots, strict=True):
        both = np.concatenate([np.column_stack([one[0][:, k], one[1][:, k]]) for one in answers])
        both = both[np.isfinite(both).all(axis=1)]
        error, level = np.minimum(both, 0.999 * _STANFORD_DEG).T
        counts = np.histogram2d(error, level, bins=(edges, edges))[0]
        plot.pcolormesh(edges, edges, np.ma.masked_equal(counts.T, 0), norm="log", cmap="viridis")
        plot.plot(edges, edges, color="#d62728", linewidth=1.0)
        plot.axhline(ALERT_DEG, color="#555555", linewidth=0.8, linestyle="--")
        misleading = int(np.count_nonzero(both[:, 0] > both[:, 1]))
        plot.set_title(f"{AXES[k]}: {misleading} of {len(both)} rows below the line mislead", fontsize=9)
        plot.set_xlabel("error, deg")
    plots[0].set_ylabel("protection level, deg")
    figure.suptitle(f"{scenario}, {len(answers)} seeds; dashed: alert limit")
    figure.savefig(path, dpi=110)


def _draw_overview(campaign: Campaign, scenarios: Sequence[str], path: Path) -> None:
    """Draw the rms of every scenario and answer on a logarithmic axis."""
    height = 1.6 + 0.22 * len(scenarios)
    figure = Figure(figsize=(11.0, max(3.0, height)), layout="constrained")
    plots: Sequence[Axes] = figure.subplots(1, 3, sharey=True)
    positions = np.arange(len(scenarios))
    for axis, plot in zip(AXES, plots, strict=True):
        for answer in (*METHODS, *BASELINES):
            reported = [
                campaign.statistics.get((name, answer), {}).get(f"rms_deg.{axis}", np.nan) for name in scenarios
            ]
            marker = _MARKERS.get(answer, "o")
            label = "zero (size of the truth)" if answer == "zero" else answer
            plot.plot(reported, positions, marker, color=_COLORS[answer], markersize=5, linestyle="none", label=label)
        plot.set_xscale("log")
        plot.set_xlabel(f"{axis} rms, deg")
    plots[0].set_yticks(positions, scenarios)
    plots[0].set_ylim(len(scenarios) - 0.5, -0.5)
    seeds = campaign.plan.seeds
    figure.suptitle("rms error of one seed" if seeds == 1 else f"rms error, mean of {seeds} seeds")
    figure.legend(*plots[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False)
    figure.savefig(path, dpi=110)
