"""Figures of a campaign: errors over time with the sigma that was stated, and all scenarios side by side."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from service.core.estimation.filtering.anchor import HYPOTHESES
from service.pipeline.config import InterlockConfig
from service.records.levels.attitude import FloatArray
from service.study.estimation.bounds import AXES
from service.study.estimation.campaign import METHODS, Campaign, Course, Rain, UnitResult
from service.study.estimation.flight.baselines import BASELINES

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
#: loss from which a station is wet, dB, and how much is drawn before and after the worst of a storm, h
_WET_DB, _STORM_HOURS = 0.3, 8.0
#: stations that are wet at once without being a storm
_FEW_WET = 2
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
                paths += _draw_smoothed(result.course, f"{scenario}, seed {result.unit.seed}", folder, scenario)
        for scenario in first:
            paths += _draw_worst_storm(campaign, scenario, folder)
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
        plot.set(ylim=(-_REACH_DEG[k], _REACH_DEG[k]), ylabel=f"{axis} error, deg")
    plots[-1].set_xlabel("hours of operation")
    figure.suptitle(title)
    figure.legend(*plots[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(path, dpi=110)


def _draw_smoothed(course: Course, title: str, folder: Path, scenario: str) -> list[Path]:
    """Draw truth, filtered and smoothed angles, axis by axis; return the file."""
    if course.smoothed_deg is None:
        return []
    path = folder / f"smoothed_{scenario}.png"
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    plots: Sequence[Axes] = figure.subplots(3, 1, sharex=True)
    lines = {
        "filtered": (course.methods["robust"].estimate_deg, "#1f77b4", 0.7),
        "smoothed": (course.smoothed_deg, "#d62728", 1.2),
        "truth": (course.truth_deg, "#000000", 0.9),
    }
    for k, (axis, plot) in enumerate(zip(AXES, plots, strict=True)):
        for label, (angles_deg, color, width) in lines.items():
            plot.plot(course.hours, angles_deg[:, k], color=color, linewidth=width, label=label)
        plot.set_ylabel(f"{axis}, deg")
    plots[-1].set_xlabel("hours of operation")
    figure.suptitle(title)
    figure.legend(*plots[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(path, dpi=110)
    return [path]


def _draw_worst_storm(campaign: Campaign, scenario: str, folder: Path) -> list[Path]:
    """Draw the storm over most stations of all seeds, if there was one; return the file."""
    courses = {one.unit.seed: one.course for one in campaign.results if one.unit.scenario == scenario}
    wet = {
        seed: (course, course.rain, (course.rain.loss_db > _WET_DB).sum(axis=1).max())
        for seed, course in courses.items()
        if course is not None and course.rain is not None
    }
    seed, (course, rain, stations) = max(wet.items(), key=lambda each: each[1][2], default=(0, (None, None, 0)))
    if course is None or rain is None or stations <= _FEW_WET:
        return []
    path = folder / f"storm_{scenario}.png"
    _draw_storm(course, rain, f"{scenario}, seed {seed}", path)
    return [path]


def _draw_storm(course: Course, rain: Rain, title: str, path: Path) -> None:
    """Draw the hours around the time when most stations are wet: level against error, and carriers against the rain."""
    robust, is_wet = course.methods["robust"], rain.loss_db > _WET_DB
    middle_h = course.hours[is_wet.sum(axis=1).argmax()]
    shown = np.abs(course.hours - middle_h) <= _STORM_HOURS
    hours, carriers = course.hours[shown], np.arange(is_wet.shape[1])
    figure = Figure(figsize=(9.0, 7.5), layout="constrained")
    angles, believed, rained = figure.subplots(3, 1, sharex=True)
    for k, color in ((1, "#1f77b4"), (2, "#2ca02c")):
        angles.plot(hours, (robust.estimate_deg - course.truth_deg)[shown, k], color=color, label=f"error of {AXES[k]}")
        if robust.protection_deg is not None:
            level_deg = robust.protection_deg[shown, k]
            angles.plot(hours, level_deg, color=color, linestyle=":", label=f"level of {AXES[k]}")
    angles.axhline(ALERT_DEG, color="#555555", linewidth=0.8, linestyle="--")
    held = np.where(robust.is_control_allowed[shown], np.nan, -0.1)
    angles.plot(hours, held, color="#d62728", linewidth=4.0, label="no control")
    angles.set(ylim=(-0.12, _STANFORD_DEG), ylabel="deg")
    angles.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5, frameon=False)
    names = ("not asked", *HYPOTHESES)
    colors = ListedColormap(["#ffffff", "#e8e8e8", "#1f77b4", "#ff7f0e", "#bcbd22"])
    drawn = believed.pcolormesh(hours, carriers, rain.hypothesis[shown].T, cmap=colors, vmin=-1.5, vmax=3.5)
    figure.colorbar(drawn, ax=believed, ticks=range(-1, 4)).ax.set_yticklabels(names)
    lost = rained.pcolormesh(hours, carriers, rain.loss_db[shown].T, cmap="Blues", vmin=0.0, vmax=2.0)
    figure.colorbar(lost, ax=rained, label="loss, dB")
    believed.set_ylabel("carrier: believed")
    rained.set(ylabel="carrier: true rain", xlabel="hours of operation")
    figure.suptitle(f"{title}: {is_wet.sum(axis=1).max()} of {len(carriers)} stations wet at once")
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
        plot.set(xscale="log", xlabel=f"{axis} rms, deg")
    plots[0].set_yticks(positions, scenarios)
    plots[0].set_ylim(len(scenarios) - 0.5, -0.5)
    seeds = campaign.plan.seeds
    figure.suptitle("rms error of one seed" if seeds == 1 else f"rms error, mean of {seeds} seeds")
    figure.legend(*plots[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False)
    figure.savefig(path, dpi=110)
