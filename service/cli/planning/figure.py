"""Map of a plan in the antenna frame: stations, the slopes of their beams as arrows, leverage as size."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from service.cli.planning.sources import CarrierPlanning

#: deg of the map for one dB/deg
_ARROW_DEG = 0.25
_COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")
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
        axes.set_xlabel("azimuth in the antenna frame, deg (East positive)")
        axes.set_ylabel("elevation, deg (North positive)")
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
