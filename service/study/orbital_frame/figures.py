"""Figures 2, 3 and 4 of the paper as the model gives them."""

from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from service.core.dynamics.orbital_frame_analysis import FlightRecord, Start, fly_spacecraft
from service.core.dynamics.orbital_frame_kernel import Fly
from service.study.orbital_frame.reproduction import STABILISATION_S, full_spacecraft, transient_flights

_COLOURS = {"yaw": "#d62728", "roll": "#1f77b4", "pitch": "#2ca02c"}
#: rows of a long flight that are drawn; an angle moves little in a second
_EVERY = 8


def draw_reproduction(kernel: Fly, folder: Path, suffix: str = "png") -> list[Path]:
    """Draw the three figures into a folder; return their paths."""
    yaw, roll = transient_flights(kernel)
    steady = fly_spacecraft(full_spacecraft(kernel), Start(), STABILISATION_S, kernel=kernel)
    named = {
        "orbital-frame-figure-2": (yaw, "Figure 2: yaw of 10 deg at the start"),
        "orbital-frame-figure-3": (roll, "Figure 3: roll of 2 deg at the start"),
        "orbital-frame-figure-4": (steady, "Figure 4: every disturbance, corrected, smallest yaw gains"),
    }
    drawn = []
    for name, (flight, title) in named.items():
        drawn.append(folder / f"{name}.{suffix}")
        _draw(flight, title, drawn[-1])
    return drawn


def _draw(flight: FlightRecord, title: str, path: Path) -> None:
    """Draw the three angles of a flight below one another."""
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "svg.hashsalt": "soo"}):
        figure = Figure(figsize=(8.0, 5.5), layout="constrained")
        plots = figure.subplots(3, 1, sharex=True)
        angles = {"yaw": flight.yaw_deg, "roll": flight.roll_deg, "pitch": flight.pitch_deg}
        for plot, (name, angle) in zip(plots, angles.items(), strict=True):
            plot.plot(flight.time_s[::_EVERY], angle[::_EVERY], color=_COLOURS[name], linewidth=0.8)
            plot.set_ylabel(f"{name}, deg")
        plots[0].set_title(title, fontsize=9)
        plots[-1].set_xlabel("s")
        figure.savefig(path, dpi=120, metadata={"Date": None} if path.suffix == ".svg" else None)
