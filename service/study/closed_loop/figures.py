"""Closed loops drawn: the three angles of every run, of one run beside its estimate, and their percentiles."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from service.study.closed_loop.campaign import LoopCampaign
from service.study.closed_loop.controllers import Sensing
from service.study.closed_loop.run import NARROW_DEG, PERCENTILES, FlownRun

_COLOURS = {Sensing.AUTOMATIC: "#1f77b4", Sensing.TRUTH: "#2ca02c", Sensing.OFF: "#d62728"}
#: deg, what is farther off is cut
_REACH_DEG = 1.0
_AXES = ("yaw", "roll", "pitch")
_STYLE: Any = {"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}


def draw_campaign(campaign: LoopCampaign, folder: Path) -> list[Path]:
    """Draw three PNG a scenario: all runs, one run with what the ground believed, and percentiles; return the paths."""
    kinds = (_draw_all, _draw_run, _draw_percentiles)
    paths = [draw(campaign, scenario, folder) for scenario in campaign.plan.scenarios for draw in kinds]
    return [path for path in paths if path is not None]


def _flights(campaign: LoopCampaign, scenario: str, sensing: Sensing) -> list[FlownRun]:
    found = [one for one in campaign.results if one.unit.scenario == scenario and one.unit.sensing is sensing]
    return [one.flight for one in found if one.flight is not None]


@contextmanager
def _drawing(path: Path, title: str) -> Iterator[Sequence[Axes]]:
    """Yield the plots of the three angles, and write them with limits, labels and legend."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(8.0, 6.0), layout="constrained")
        plots = figure.subplots(3, 1, sharex=True)
        plots[0].set_title(title, fontsize=9)
        for name, limit, plot in zip(_AXES, NARROW_DEG, plots, strict=True):
            for side in (-1.0, 1.0):
                plot.axhline(side * limit, color="#111111", linewidth=0.8, linestyle="--")
            plot.set(ylabel=f"{name}, deg", ylim=(-_REACH_DEG, _REACH_DEG))
        yield plots
        figure.legend(*plots[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
        plots[-1].set_xlabel("hours of operation")
        figure.savefig(path, dpi=120)


def _draw_run(campaign: LoopCampaign, scenario: str, folder: Path) -> Path | None:
    """Draw the first run under the chain: truth, estimate, and when control was inhibited."""
    flights = _flights(campaign, scenario, Sensing.AUTOMATIC)
    if not flights:
        return None
    flight, path = flights[0], folder / f"closed-loop-{scenario}-run.png"
    inhibited: Any = {"where": flight.is_inhibited, "color": "#cccccc", "label": "control inhibited"}
    with _drawing(path, f"{scenario}: seed 1 under the chain") as plots:
        for axis, plot in enumerate(plots):
            plot.plot(flight.hours, flight.estimate_deg[:, axis], color="#ff7f0e", linewidth=0.6, label="estimate")
            plot.plot(flight.hours, flight.truth_deg[:, axis], color="#1f77b4", linewidth=1.0, label="truth")
            plot.fill_between(flight.hours, -1.0, 1.0, **inhibited)
    return path


def _draw_percentiles(campaign: LoopCampaign, scenario: str, folder: Path) -> Path | None:
    """Draw the percentiles of the size of each angle over the runs under the chain, hour by hour."""
    flights = _flights(campaign, scenario, Sensing.AUTOMATIC)
    if not flights:
        return None
    path, rows = folder / f"closed-loop-{scenario}-percentiles.png", min(len(flight.hours) for flight in flights)
    sizes = np.abs(np.array([flight.truth_deg[:rows] for flight in flights]))
    with _drawing(path, f"{scenario}: size of the angles over {len(flights)} runs under the chain") as plots:
        for axis, plot in enumerate(plots):
            for share, shade in zip(PERCENTILES, ("#9ecae1", "#3182bd", "#08306b"), strict=True):
                reached = np.percentile(sizes[:, :, axis], share, axis=0, method="higher")
                plot.plot(flights[0].hours[:rows], reached, color=shade, linewidth=1.0, label=f"{share} % of runs")
            plot.set_ylim(0.0, _REACH_DEG)
    return path


def _draw_all(campaign: LoopCampaign, scenario: str, folder: Path) -> Path:
    path = folder / f"closed-loop-{scenario}.png"
    with _drawing(path, f"{scenario}: truth of {campaign.plan.runs} runs under each sensing") as plots:
        for sensing in Sensing:
            for number, flight in enumerate(_flights(campaign, scenario, sensing)):
                style: Any = {"color": _COLOURS[sensing], "linewidth": 0.7, "label": None if number else sensing.value}
                for axis, plot in enumerate(plots):
                    plot.plot(flight.hours, flight.truth_deg[:, axis], **style)
    return path
