"""Closed loops drawn: the three angles of every run, one figure a scenario."""

from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from service.study.closed_loop.campaign import LoopCampaign
from service.study.closed_loop.controllers import Sensing
from service.study.closed_loop.merit import NARROW_DEG

_COLOURS = {Sensing.AUTOMATIC: "#1f77b4", Sensing.TRUTH: "#2ca02c", Sensing.OFF: "#d62728"}
#: deg, what is farther off is cut
_REACH_DEG = 1.0


def draw_campaign(campaign: LoopCampaign, folder: Path) -> list[Path]:
    """Draw one PNG a scenario; return their paths."""
    return [_draw(campaign, scenario, folder) for scenario in campaign.plan.scenarios]


def _draw(campaign: LoopCampaign, scenario: str, folder: Path) -> Path:
    path = folder / f"closed-loop-{scenario}.png"
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(8.0, 6.0), layout="constrained")
        plots = figure.subplots(3, 1, sharex=True)
        for axis, (name, plot) in enumerate(zip(("yaw", "roll", "pitch"), plots, strict=True)):
            for result in campaign.results:
                if result.unit.scenario == scenario and result.flight is not None:
                    flight, sensing = result.flight, result.unit.sensing
                    label = sensing.value if result.unit.seed == 1 else None
                    colour = _COLOURS[sensing]
                    plot.plot(flight.hours, flight.truth_deg[:, axis], color=colour, linewidth=0.7, label=label)
            for side in (-1.0, 1.0):
                plot.axhline(side * NARROW_DEG[axis], color="#111111", linewidth=0.8, linestyle="--")
            plot.set_ylabel(f"{name}, deg")
            plot.set_ylim(-_REACH_DEG, _REACH_DEG)
        plots[0].set_title(f"{scenario}: truth of {campaign.plan.runs} runs under each sensing", fontsize=9)
        figure.legend(*plots[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
        plots[-1].set_xlabel("hours of operation")
        figure.savefig(path, dpi=120)
    return path
