"""Figures 2 to 5 of the paper, which are lost, drawn from their equations."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from service.core.arrays import FloatArray
from service.core.flexible.capture import least_capturing_amplitude_rad, rigid_frequency_rad_s, stable_band
from service.core.flexible.limit_cycle import cycle_period_s, koenigs_lamerey, succession
from service.core.flexible.motion import FlexibleMotion, follow_motion
from service.core.flexible.propagation import BodyState
from service.core.flexible.spacecraft import HubMode, SwitchingLaw, WheelDrive
from service.study.limit_cycles import reference
from service.study.limit_cycles.report import cycle_of, cycle_switch, mode_of, motion_of, switch_of

_COLORS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd")
#: mode of the panels in the figure of the cycles; the paper gives none
_MODE = HubMode(0.5, 0.005, 0.5)
_NAMES = ("A0", "B3", "C2")
_SETTLED_PERIODS = 4.0
#: angles are drawn in mrad
_MRAD = 1e3


def draw_figures(folder: Path, *, suffix: str = "png") -> list[Path]:
    """Draw all figures into a folder; suffix png or svg; return the files."""
    drawings: dict[str, Callable[[Path], None]] = {
        "bi-plane": _draw_bi_plane,
        "cycles": _draw_cycles,
        "ladder": _draw_ladders,
        "stability": _draw_stability,
    }
    paths = []
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "svg.hashsalt": "soo"}):
        for name, draw in drawings.items():
            paths.append(folder / f"limit-cycles-{name}.{suffix}")
            draw(paths[-1])
    return paths


def _save(figure: Figure, path: Path) -> None:
    """Save a figure without the date, so that the same figure is the same file."""
    figure.savefig(path, dpi=110, metadata={"Date": None} if path.suffix == ".svg" else {"Software": None})


def _draw_bi_plane(path: Path) -> None:
    """Figure 2: one switching of the relay on both sheets, below and above the boundary of capture."""
    case = reference.CAPTURES[7]
    mode, least = mode_of(case), least_capturing_amplitude_rad(switch_of(case), mode_of(case))
    figure = Figure(figsize=(9.5, 4.2), layout="constrained")
    sheets: Sequence[Axes] = figure.subplots(1, 3)
    for color, share in zip(_COLORS, (0.6, 1.2), strict=False):
        motion = _relay_from_line(mode, share * least)
        times = np.linspace(0.0, motion.end_s, 1500)
        states = motion.states(times)
        label = f"p0 = {share:g} p_min"
        sheets[0].plot(_MRAD * states[:, 0], _MRAD * states[:, 1] / mode.omega_rad_s, color=color, label=label)
        sheets[1].plot(_MRAD * states[:, 2], _MRAD * states[:, 3] / mode.omega_rad_s, color=color)
        sheets[2].plot(times, _MRAD * (states[:, 0] + states[:, 2]), color=color)
    for angle, name in ((case.alpha_rad, "alpha"), (case.beta_rad, "beta")):
        sheets[2].axhline(_MRAD * angle, color="#555555", linewidth=0.8, linestyle="--")
        sheets[2].annotate(name, (0.0, _MRAD * angle), va="bottom")
    for sheet, sub in zip(sheets[:2], ("T", "U"), strict=True):
        sheet.set(xlabel=f"theta_{sub}, mrad", ylabel=f"theta_{sub}' / w, mrad")
    sheets[2].set(xlabel="time, s", ylabel="theta, mrad")
    figure.suptitle("Relay on the phase bi-plane: body as a rigid one, flexible mode, what the sensor sees")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    _save(figure, path)


def _relay_from_line(mode: HubMode, amplitude_rad: float) -> FlexibleMotion:
    """Return the motion of a relay from its line with a swing of the mode at its worst phase."""
    inertia = reference.BASE.inertia_kg_m2
    drive = WheelDrive(inertia, 0.2, reference.PASSIVE_RAD_S2 * inertia, momentum_limit_n_m_s=1e6)
    start = BodyState(reference.BETA_RAD - amplitude_rad, 1e-4, amplitude_rad, momentum_n_m_s=-1e3)
    law = SwitchingLaw(reference.ALPHA_RAD, reference.BETA_RAD, math.inf)
    return follow_motion(start, drive, mode, law, 4.0 * math.pi / mode.omega_rad_s)


def _draw_cycles(path: Path) -> None:
    """Figures 3 and 4: cycles A, B, C of the rigid body, and a mode under the same law once it has settled."""
    figure = Figure(figsize=(9.5, 4.6), layout="constrained")
    rigid, flexible = figure.subplots(1, 2)
    for color, name in reversed(list(zip(_COLORS, _NAMES, strict=False))):
        cycle = cycle_of(name)
        closed = _cycle_states(name, None, 0.0)
        swung = _cycle_states(name, _MODE, _SETTLED_PERIODS)
        label = f"{name}: {cycle.period_s:.0f} s, multiplier {cycle.multiplier:.3f}"
        rigid.plot(_MRAD * closed[:, 0], _MRAD * closed[:, 1], color=color, label=label)
        flexible.plot(_MRAD * swung[:, 2], _MRAD * swung[:, 3] / _MODE.omega_rad_s, color=color, linewidth=0.5)
    rigid.set(xlabel="theta_T, mrad", ylabel="theta_T', mrad/s", title="rigid body")
    flexible.set(
        xlabel="theta_U, mrad",
        ylabel="theta_U' / w, mrad",
        title=f"w {_MODE.omega_rad_s:g} rad/s, xi {_MODE.damping_ratio:g}, kn {_MODE.coupling:g}",
    )
    figure.suptitle("Limit cycles on both sheets")
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    _save(figure, path)


def _cycle_states(name: str, mode: HubMode | None, after_periods: float) -> FloatArray:
    """Return states over one period of a cycle, some periods after its start."""
    case, cycle = reference.CYCLES[name], cycle_of(name)
    momentum = case.drive.momentum_n_m_s - case.drive.inertia_kg_m2 * cycle.speed_rad_s
    start = BodyState(-case.law.beta_rad, -cycle.speed_rad_s, momentum_n_m_s=momentum)
    motion = follow_motion(start, case.drive, mode, case.law, (after_periods + 1.0) * cycle.period_s)
    return motion.states(np.linspace(after_periods * cycle.period_s, motion.end_s, 6000))


def _draw_ladders(path: Path) -> None:
    """Ladders of Koenigs and Lamerey for the three cycles."""
    figure = Figure(figsize=(9.5, 3.9), layout="constrained")
    plots: Sequence[Axes] = figure.subplots(1, 3)
    for name, start, returns, plot in zip(_NAMES, (1.05e-4, 1.2e-4, 1.2e-4), (60, 25, 40), plots, strict=True):
        motion = motion_of(name)
        speeds = np.linspace(1e-6, motion.pulse_rad_s2 * motion.pulse_s, 700)
        following = succession(speeds, motion)
        # a jump is no part of the function
        following[1:][np.abs(np.diff(following)) > 5e-6] = np.nan
        plot.plot(_MRAD * speeds, _MRAD * following, color=_COLORS[0], label="succession function")
        plot.plot(_MRAD * speeds, _MRAD * speeds, color="#555555", linewidth=0.8)
        ladder = koenigs_lamerey(start, returns, motion)
        plot.plot(*(_MRAD * ladder.T), color=_COLORS[1], linewidth=0.6, label="ladder")
        plot.set(title=f"{name}, multiplier {cycle_of(name).multiplier:.4f}", xlabel="w_k, mrad/s")
    plots[0].set_ylabel("w_k+1, mrad/s")
    figure.legend(*plots[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    _save(figure, path)


def _draw_stability(path: Path) -> None:
    """Figure 5: band of frequencies without capture, and surface (26) beside the cycle's own frequency."""
    figure = Figure(figsize=(9.5, 4.4), layout="constrained")
    band, surface = figure.subplots(1, 2)
    swings = np.geomspace(2e-5, 3e-3, 400)
    for color, coupling in zip(_COLORS, reference.BANDS, strict=False):
        found = np.array([stable_band(cycle_switch(), coupling, float(swing)) for swing in swings])
        band.fill_betweenx(swings, found[:, 0], found[:, 1], color=color, alpha=0.15)
        band.plot(np.concatenate([found[:, 0], found[::-1, 1]]), np.concatenate([swings, swings[::-1]]), color=color)
        band.plot([], [], color=color, label=f"kn {coupling:g}")
    band.set(
        xscale="log",
        yscale="log",
        xlabel="w, rad/s",
        ylabel="C, swing from peak to peak over alpha",
        title="free of capture inside",
    )
    band.legend()
    omegas = np.linspace(0.3, 12.0, 400)
    for color, swing in zip(_COLORS, (0.0, 1e-3, 5e-3, 2e-2, 8e-2), strict=True):
        bound = [rigid_frequency_rad_s(cycle_switch(), HubMode(float(w), 0.01, 0.5), swing) for w in omegas]
        surface.plot(omegas, bound, color=color, label=f"C {swing:g}")
    own = 2.0 * math.pi / cycle_period_s(reference.BASE, 1.0, 1)
    surface.axhline(own, color="#555555", linestyle="--", linewidth=0.9, label="cycle A0")
    surface.set(xlabel="w, rad/s", ylabel="w_T, rad/s", title="surface (26), kn 0.5: a cycle below it is free")
    surface.legend()
    _save(figure, path)
