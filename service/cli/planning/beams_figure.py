"""Figure of the beams: boresight of each antenna by the hour, and contours of each beam over its stations."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from service.core.estimation.beams.station_beams import StationBeams, beam_surface, surface_db

_COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")
#: deg of the map for one dB/deg; deg that contours reach beyond the stations
_ARROW_DEG, _MARGIN_DEG = 0.15, 0.4
_CONTOURS_DB = np.arange(-12.0, 0.5, 1.0)
_MIN_STATIONS = 3


def draw_beams(document: dict[str, Any], spacecraft: str, path: Path) -> None:
    """Draw a report into a PNG or SVG file."""
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "date.converter": "concise"}):
        figure = Figure(figsize=(9.0, 9.5), layout="constrained")
        panels = figure.subplots(3, 1, height_ratios=(1.0, 1.0, 2.4))
        for axes, axis in zip(panels[:2], ("east", "north"), strict=True):
            _draw_series(axes, document, axis)
        panels[1].set_xlabel("UTC")
        _draw_map(panels[2], document["stations"])
        figure.suptitle(f"{spacecraft}: boresight since calibration {document['calibration_id']}, and beams")
        figure.savefig(path, dpi=120)


def _draw_series(axes: Any, document: dict[str, Any], axis: str) -> None:
    """Draw one axis of all antennas with two sigma."""
    at = np.array([each.removesuffix("Z") for each in document["epochs"]], dtype="datetime64[us]")
    for number, antenna in enumerate(document["antennas"]):
        value, sigma = (np.array(antenna[f"{axis}{part}_deg"], dtype=np.float64) for part in ("", "_sigma"))
        colour = _COLOURS[number % len(_COLOURS)]
        axes.fill_between(at, value - 2.0 * sigma, value + 2.0 * sigma, color=colour, alpha=0.2, linewidth=0)
        axes.plot(at, value, color=colour, linewidth=1.0, label=antenna["antenna"])
    axes.set_ylabel(f"{axis}, deg")
    if document["antennas"]:
        axes.legend(loc="upper right", ncols=4, frameon=False)


def _draw_map(axes: Any, stations: list[dict[str, Any]]) -> None:
    """Draw stations with their gradients, and contours of each beam that has enough of them, dB below its peak."""
    names = sorted({each["transponder"] for each in stations})
    for number, name in enumerate(names):
        own = [each for each in stations if each["transponder"] == name]
        position = np.array([[each["azimuth_deg"], each["elevation_deg"]] for each in own])
        beams = _beams(own)
        colour = _COLOURS[number % len(_COLOURS)]
        axes.scatter(*position.T, s=20.0, color=colour, label=name, zorder=3)
        for each, at, slope in zip(own, position, beams.gradient_db_deg, strict=True):
            axes.annotate("", at + _ARROW_DEG * slope, at, arrowprops={"arrowstyle": "->", "color": colour})
            axes.annotate(each["carrier"], at, xytext=(4, 4), textcoords="offset points", fontsize=7)
        if len(own) >= _MIN_STATIONS:
            _draw_contours(axes, position, beams, colour)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(f"azimuth, deg East; arrows: where the level rises, {_ARROW_DEG:g} deg for 1 dB/deg")
    axes.set_ylabel("elevation, deg North")
    if names:
        axes.legend(loc="upper right", ncols=4, frameon=False)


def _draw_contours(axes: Any, position: np.ndarray, beams: StationBeams, colour: str) -> None:
    """Draw the surface of degree three between the stations, each dB below its greatest value there."""
    low, high = position.min(axis=0) - _MARGIN_DEG, position.max(axis=0) + _MARGIN_DEG
    east, north = np.meshgrid(np.linspace(low[0], high[0], 80), np.linspace(low[1], high[1], 80))
    gain_db = surface_db(np.stack([east, north], axis=-1), beam_surface(position, beams))
    drawn = axes.contour(
        east, north, gain_db - gain_db.max(), levels=_CONTOURS_DB, colors=colour, linewidths=0.6, alpha=0.7
    )
    axes.clabel(drawn, fmt="%g", fontsize=6)


def _beams(stations: list[dict[str, Any]]) -> StationBeams:
    """Return the beams of an answer as arrays."""

    def table(name: str) -> np.ndarray:
        rows = [[np.nan if value is None else value for value in each[name].values()] for each in stations]
        return np.array(rows, dtype=np.float64)

    sigma = table("gradient_sigma_db_per_deg")
    covariance = sigma[:, :, None] * np.eye(2) * sigma[:, None]
    curvature = table("curvature_db_per_deg2"), table("curvature_sigma_db_per_deg2")
    return StationBeams(table("gradient_db_per_deg"), sigma, covariance, *curvature)
