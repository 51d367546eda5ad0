"""Figures drawn for people: estimate beside truth."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from service.records.epoch import US_PER_S
from service.study.demonstration import TrackedAngles
from service.study.merit import AXES


def draw_tracking(tracked: TrackedAngles, path: Path) -> None:
    """Draw the three angles, estimate over truth, into a PNG or SVG file."""
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(8.0, 5.4), layout="constrained")
        axes = figure.subplots(3, 1, sharex=True)
        hours = (tracked.epochs_us - tracked.epochs_us[0]) / US_PER_S / 3600.0
        for k, (name, plot) in enumerate(zip(AXES, axes, strict=True)):
            plot.plot(hours, tracked.truth_deg[:, k], color="#111111", linewidth=1.4, label="truth")
            plot.plot(hours, tracked.estimate_deg[:, k], color="#1f77b4", linewidth=0.8, label="estimate")
            held = np.where(tracked.is_control_allowed, np.nan, 0.0)
            plot.plot(hours, held, color="#d62728", linewidth=3.0, alpha=0.6, label="control inhibited")
            plot.set_ylabel(f"{name}, deg")
        # above the plots: an excursion may reach any corner of them
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
        axes[-1].set_xlabel("hours of operation")
        figure.savefig(path, dpi=120)
