"""Figures drawn for people: estimates with the truth, and what control makes of it."""

from collections.abc import Callable, Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from service.records.epoch import US_PER_S
from service.records.levels.attitude import FloatArray
from service.study.demonstration.control_centre import AXES
from service.study.demonstration.judgement import METHODS, USUAL_BOUNDS_DEG, FlightAlone, TrackedAngles

_COLOURS = {"robust": "#1f77b4", "paper": "#ff7f0e"}
#: deg, what is farther off is cut
_REACH_DEG = 0.75


def draw_tracking(tracked: Mapping[str, TrackedAngles], path: Path) -> None:
    """Draw the three angles of every method over the truth into a PNG or SVG file."""
    _draw(path, lambda plot, k: _draw_axis(plot, tracked, k))


def draw_control(tracked: TrackedAngles, alone: FlightAlone, path: Path) -> None:
    """Draw the angles of a spacecraft that is controlled and of the same one left alone; dashed: the usual bounds."""

    def draw_axis(plot: Axes, k: int) -> None:
        hours = _hours(tracked)
        plot.plot(alone.hours, alone.flown_deg[:, k], color="#d62728", linewidth=1.0, label="truth, left alone")
        _draw_driving(plot, tracked, hours, k)
        for side, label in ((-1.0, None), (1.0, "95 of 100 runs")):
            plot.axhline(side * USUAL_BOUNDS_DEG[AXES[k]], color="#111111", linewidth=0.8, linestyle="--", label=label)

    _draw(path, draw_axis)


def _draw(path: Path, draw_axis: Callable[[Axes, int], None]) -> None:
    """Draw one plot an axis into a file."""
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(8.0, 6.0), layout="constrained")
        plots = figure.subplots(3, 1, sharex=True)
        for k, (name, plot) in enumerate(zip(AXES, plots, strict=True)):
            draw_axis(plot, k)
            plot.set(ylabel=f"{name}, deg", ylim=(-_REACH_DEG, _REACH_DEG))
        # above the plots: an excursion may reach any corner of them
        figure.legend(*plots[0].get_legend_handles_labels(), loc="outside upper center", ncols=6, frameon=False)
        plots[-1].set_xlabel("hours of operation")
        figure.savefig(path, dpi=120)


def _draw_axis(plot: Axes, tracked: Mapping[str, TrackedAngles], k: int) -> None:
    """Draw one angle: the other method below, then the driving one with its sigma, the truth on top."""
    driving, peers = (tracked[method] for method in METHODS)
    others = (peers.epochs_us - driving.epochs_us[0]) / US_PER_S / 3600.0
    plot.plot(others, peers.estimate_deg[:, k], color=_COLOURS[METHODS[1]], linewidth=0.6, label=METHODS[1])
    _draw_driving(plot, driving, _hours(driving), k)


def _draw_driving(plot: Axes, driving: TrackedAngles, hours: FloatArray, k: int) -> None:
    """Draw the method that drives control with its sigma, the truth on top, and where control is inhibited."""
    low, high = (driving.estimate_deg[:, k] + side * 2.0 * driving.sigma_deg[:, k] for side in (-1.0, 1.0))
    plot.fill_between(hours, low, high, color=_COLOURS[METHODS[0]], alpha=0.2, linewidth=0.0, label="two sigma")
    plot.plot(hours, driving.estimate_deg[:, k], color=_COLOURS[METHODS[0]], linewidth=1.0, label=METHODS[0])
    plot.plot(hours, driving.truth_deg[:, k], color="#111111", linewidth=1.0, label="truth")
    held = np.where(driving.is_control_allowed, np.nan, 0.0)
    plot.plot(hours, held, color="#d62728", linewidth=3.0, alpha=0.6, label="control inhibited")


def _hours(tracked: TrackedAngles) -> FloatArray:
    return np.asarray((tracked.epochs_us - tracked.epochs_us[0]) / US_PER_S / 3600.0)
