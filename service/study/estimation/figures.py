"""Figures of a campaign: errors over time with the sigma that was stated, and all scenarios side by side."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

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
