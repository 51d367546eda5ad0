"""Figures 1, 2 and 3 of the paper as the product gives them."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from service.study.estimation.flight.world import AXES
from service.study.rf_attitude.reproduction import AMPLITUDE_DB, PERIOD_H, Session, published_curve

#: deg, of the figure's orbit: the paper has no more than this
_LATITUDE_DEG = 0.05
_STYLE: Any = {"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}
_METHODS = {"paper": "#2ca02c", "robust": "#1f77b4"}


def draw_reproduction(session: Session, folder: Path) -> list[Path]:
    """Draw the three figures into a folder; return their paths."""
    with mpl.rc_context(_STYLE):
        paths = [_draw_curve(folder / "rf-attitude-figure-1.png")]
        for method, number in (("paper", 2), ("robust", 3)):
            paths.append(_draw_angles(session, method, folder / f"rf-attitude-figure-{number}.png"))
    return paths


def _draw_curve(path: Path) -> Path:
    """Draw powers of two days with the fitted curve, and the latitude of the spacecraft."""
    curve = published_curve(days=2.0)
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    power, latitude = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    power.plot(curve.hours, curve.power_dbw, ".", color="#999999", markersize=1.5, label="printed curve and its noise")
    power.plot(curve.hours, curve.fitted_dbw, color="#1f77b4", linewidth=2.0, label="fit of the product")
    fit = curve.fit
    power.set_title(
        f"Figure 1: am {fit.amplitude_db:.4f} dB ({AMPLITUDE_DB}), phi {fit.phase_rad:.4f} rad, "
        f"h {fit.offset_dbm - 30.0:.4f} dBW, rms {fit.rms_db:.4f} dB",
        fontsize=9,
    )
    power.set_ylabel("dBW")
    power.legend(loc="lower right", fontsize=8)
    latitude.plot(curve.hours, _LATITUDE_DEG * np.sin(2.0 * np.pi * curve.hours / PERIOD_H), color="#d62728")
    latitude.set(ylabel="latitude, deg", xlabel="hours since the ascending node")
    figure.savefig(path, dpi=110)
    return path


def _draw_angles(session: Session, method: str, path: Path) -> Path:
    """Draw estimate and sensor of each angle, and the angle of the alignment."""
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    plots = figure.subplots(3, 1, sharex=True)
    start_us = session.world.ground.phases["operation"].start_us
    rows_h = (session.world.ground.epochs_us[session.driven.rows] - start_us) / 3.6e9
    for axis, plot in enumerate(plots):
        epochs_us, sensed, _ = session.differences_deg(method, axis)
        sensor = "direction finder" if axis == 0 else "Earth sensor"
        plot.plot((epochs_us - start_us) / 3.6e9, sensed, ".", color="#bbbbbb", markersize=2.0, label=sensor)
        estimate = session.driven.methods[method].estimate_deg[:, axis]
        plot.plot(rows_h, estimate, color=_METHODS[method], linewidth=1.0, label=f"powers, {method} method")
        plot.axhline(session.driven.alignment_deg[axis], color="#d62728", linewidth=0.8, label="alignment")
        plot.set_ylabel(f"{AXES[axis]}, deg")
        plot.legend(loc="upper right", fontsize=7, ncols=3)
    plots[0].set_title(f"Angles of the {method} method beside other sensors, simulated, seed 1", fontsize=9)
    plots[-1].set_xlabel("hours of operation")
    figure.savefig(path, dpi=110)
    return path
