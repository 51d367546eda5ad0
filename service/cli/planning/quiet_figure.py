"""Figure of quiet days: Allan deviation, daily change, and the angles of the rehearsal with sigma and protection."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from service.cli.planning.sources import CarrierPlanning
from service.pipeline.planning.rehearsal import ExpectedAccuracy, Rehearsal

_AXES = ("yaw", "roll", "pitch")
_USABLE, _UNUSABLE, _ESTIMATE = "#1f77b4", "#999999", "#d62728"


def draw_quiet_days(planning: CarrierPlanning, rehearsal: Rehearsal, path: Path) -> None:
    """Draw the figure into a PNG or SVG file."""
    quiet = planning.document["quiet"]
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(11.0, 6.5), layout="constrained")
        panels = figure.subplot_mosaic(
            [
                ["allan", "yaw"],
                ["allan", "yaw"],
                ["allan", "roll"],
                ["daily", "roll"],
                ["daily", "pitch"],
                ["daily", "pitch"],
            ]
        )
        _draw_allan(panels["allan"], quiet["carriers"])
        _draw_daily(panels["daily"], quiet["carriers"])
        for axis, name in enumerate(_AXES):
            _draw_angle(panels[name], rehearsal.prediction, axis)
        panels["pitch"].set_xlabel("hours of the rehearsal")
        panels["yaw"].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
        figure.suptitle(f"{planning.name}: {quiet['days']:.1f} quiet days from {quiet['start'][:16]}Z")
        figure.savefig(path, dpi=110)


def _draw_allan(panel: Any, carriers: list[dict[str, Any]]) -> None:
    """Draw the Allan deviation of every carrier, and the usual one."""
    spans_s = [one["span_s"] for one in carriers[0]["allan_db"]]
    values = np.array([[one["deviation_db"] for one in row["allan_db"]] for row in carriers], dtype=np.float64)
    for row, one in zip(carriers, values, strict=True):
        panel.loglog(spans_s, one, color=_USABLE if row["usable"] else _UNUSABLE, alpha=0.4, linewidth=0.9)
    known = np.isfinite(values).any(axis=0)
    panel.loglog(np.array(spans_s)[known], np.nanmedian(values[:, known], axis=0), "k-o", markersize=3, label="median")
    panel.set_xlabel("averaging time, s")
    panel.set_ylabel("Allan deviation, dB")
    panel.set_title("carriers, grey: not usable")
    panel.legend()


def _draw_daily(panel: Any, carriers: list[dict[str, Any]]) -> None:
    """Draw the amplitude of the daily change, and the rms that its fit leaves."""
    at = np.arange(len(carriers))
    for shift, field, label, colour in (
        (-0.2, "amplitude_db", "daily amplitude", _USABLE),
        (0.2, "rms_db", "rms after the fit", "#ff7f0e"),
    ):
        heights = [row["daily_change"][field] or 0.0 for row in carriers]
        panel.bar(at + shift, heights, 0.4, color=colour, label=label)
    panel.set_xticks(at, [row["carrier"] for row in carriers], rotation=90, fontsize=7)
    panel.set_ylabel("dB")
    panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)


def _draw_angle(panel: Any, prediction: ExpectedAccuracy, axis: int) -> None:
    """Draw one angle of the rehearsal within two sigma and its protection level."""
    hours = (prediction.epochs_us - prediction.epochs_us[0]) / 3.6e9
    angle_deg, sigma_deg = prediction.attitude_deg[:, axis], prediction.sigma_deg[:, axis]
    panel.fill_between(hours, angle_deg - 2.0 * sigma_deg, angle_deg + 2.0 * sigma_deg, alpha=0.3, label="two sigma")
    panel.plot(hours, angle_deg, color=_ESTIMATE, linewidth=0.8, label="estimate")
    for sign in (-1.0, 1.0):
        label = "protection level" if sign > 0.0 else None
        panel.plot(hours, sign * prediction.protection_deg[:, axis], "k--", linewidth=0.7, label=label)
    panel.set_ylabel(f"{_AXES[axis]}, deg")
