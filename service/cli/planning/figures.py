"""Figures of plans: carriers, quiet days."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from service.cli.planning.sources import CarrierPlanning
from service.pipeline.planning.rehearsal import ExpectedAccuracy, Rehearsal

_COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")
#: deg of the map for one dB/deg
_ARROW_DEG = 0.25
_UNCHOSEN = "#999999"
#: inches; the height follows the stations between these, title, labels and legend included
_WIDTH_IN, _HEIGHTS_IN, _MARGINS_IN = 9.0, (3.6, 8.0), 1.8


def draw_planning(planning: CarrierPlanning, path: Path) -> None:
    """Draw the map into a PNG or SVG file."""
    document = planning.document
    leverage = {row["carrier"]: row["leverage"] for row in document["sets"][document["rule"]]["carriers"]}
    names = sorted({row["transponder"] for row in document["carriers"]})
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(_WIDTH_IN, _height_in(planning)), layout="constrained")
        axes = figure.subplots()
        for number, name in enumerate(names):
            # an empty plot gives the legend its entry whether or not a carrier of the transponder was chosen
            axes.scatter([], [], s=60.0, color=_COLOURS[number % len(_COLOURS)], label=name)
        axes.scatter([], [], s=24.0, facecolors="none", edgecolors=_UNCHOSEN, label="left out")
        for k, row in enumerate(document["carriers"]):
            position = float(planning.direction.azimuth_deg[k]), float(planning.direction.elevation_deg[k])
            if np.isfinite(position).all():
                colour = _COLOURS[names.index(row["transponder"]) % len(_COLOURS)]
                _draw_station(axes, row, position, leverage.get(row["carrier"]), colour)
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.12)
        axes.set(xlabel="azimuth in the antenna frame, deg (East positive)", ylabel="elevation, deg (North positive)")
        axes.set_title(
            f"{planning.name}: arrows show where the level rises, {_ARROW_DEG:g} deg for 1 dB/deg; size: leverage"
        )
        figure.legend(loc="outside lower center", ncols=min(len(names) + 1, 9), frameon=False)
        figure.savefig(path, dpi=120)


def _height_in(planning: CarrierPlanning) -> float:
    """Return the height at which the map of the stations fills the figure."""
    spans = [np.ptp(part[np.isfinite(part)]) if np.isfinite(part).any() else 1.0 for part in planning.direction]
    # a margin of a degree about the stations is where their arrows end
    ratio = (spans[1] + 1.0) / (spans[0] + 1.0)
    return float(np.clip(_WIDTH_IN * ratio + _MARGINS_IN, *_HEIGHTS_IN))


def _draw_station(
    axes: Any, row: dict[str, Any], position: tuple[float, float], leverage: float | None, colour: str
) -> None:
    """Draw one station: filled where its carrier was chosen."""
    if row["selected"]:
        axes.scatter(*position, s=20.0 + 400.0 * (leverage or 0.0), color=colour, alpha=0.75, zorder=3)
    else:
        axes.scatter(*position, s=24.0, facecolors="none", edgecolors=_UNCHOSEN, zorder=3)
    slope = row["sensitivity_db_per_deg"]
    if slope["roll"] is not None and slope["pitch"] is not None:
        # positive roll moves a station South, positive pitch moves it West
        rise = (-_ARROW_DEG * slope["pitch"], -_ARROW_DEG * slope["roll"])
        head = {"arrowstyle": "-|>", "color": colour if row["selected"] else _UNCHOSEN, "linewidth": 1.0}
        axes.annotate("", (position[0] + rise[0], position[1] + rise[1]), position, arrowprops=head, zorder=2)
        # an annotation does not widen the limits of the axes by itself
        axes.update_datalim([(position[0] + rise[0], position[1] + rise[1])])
    axes.annotate(row["carrier"], position, xytext=(5, 5), textcoords="offset points", fontsize=7)


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
    panel.set(xlabel="averaging time, s", ylabel="Allan deviation, dB", title="carriers, grey: not usable")
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
