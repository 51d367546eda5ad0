"""Figure of two versions: the difference of each angle over the span, between three sigmas of both together."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from service.cli.operation.comparison.version_comparison import AXES, Comparison

_SIGMAS = 3.0


def draw_comparison(found: Comparison, title: str, path: Path) -> None:
    """Draw a comparison into a PNG or SVG file."""
    epochs = found.first.epochs_us[found.in_first].astype("datetime64[us]")
    difference_deg = found.difference_deg
    sigma_deg = np.hypot(found.first.sigma_deg[found.in_first], found.second.sigma_deg[found.in_second])
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "date.converter": "concise"}):
        figure = Figure(figsize=(9.0, 6.5), layout="constrained")
        for k, (axes, axis) in enumerate(zip(figure.subplots(3, 1, sharex=True), AXES, strict=True)):
            band = _SIGMAS * sigma_deg[:, k]
            axes.fill_between(
                epochs, -band, band, color="#999999", alpha=0.3, linewidth=0, label="three sigmas of both"
            )
            axes.plot(epochs, difference_deg[:, k], color="#1f77b4", linewidth=0.8, label="difference")
            axes.set_ylabel(f"{axis}, deg")
        axes.set_xlabel("UTC")
        axes.legend(loc="upper right", ncols=2, frameon=False)
        figure.suptitle(title)
        figure.savefig(path, dpi=120)
