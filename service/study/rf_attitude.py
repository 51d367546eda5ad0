"""Attitude from retransmitted carriers on Yamal-200 (Sevast'yanov): figures of the paper beside those of the product.

The paper gives no raw data. Its curve is made again from the printed parameters with the printed rms as white noise, so
that what is shown is the product's fit; sessions are worlds of the simulator, whose Earth sensor and direction finder
(20 min of each hour) go on in operation for the judge alone.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from service.core.estimation.paper.harmonic import HarmonicFit, evaluate_harmonic, fit_harmonic
from service.core.geometry.line_of_sight import node_phase_rad
from service.records.levels.attitude import FloatArray, IntArray
from service.study.estimation.flight.drive import Driven, drive
from service.study.estimation.flight.world import AXES, World, simulated_world
from service.study.published import Row, row, statement_row

#: am, phi, h, rms and period of figure 1
AMPLITUDE_DB, PHASE_RAD, OFFSET_DBW, RMS_DB, PERIOD_H = 0.3489, -0.6178, -72.8866, 0.1857, 23.98
#: the same carrier's amplitude as a turn, deg; agreement of the means of sessions, deg
TURN_DEG, AGREEMENT_DEG = 0.3, 0.1
SCENARIO, OPERATION_DAYS, SESSION_H = "sensors", 1.0, 6.0
#: share of the sessions that "as a rule" means here
RULE_SHARE = 0.75
_DBM = 30.0
_MINUTE_US = 60_000_000
_PERIOD_DAYS = 10


class Curve(NamedTuple):
    """Powers of the printed curve and what the product fits to them; T rows a minute apart."""

    #: (T,) since the ascending node
    hours: FloatArray
    #: (T,) dBW
    power_dbw: FloatArray
    fit: HarmonicFit
    #: (T,) dBW
    fitted_dbw: FloatArray


class Session(NamedTuple):
    """One world: a day of operation under both methods beside the sensors."""

    world: World
    driven: Driven

    def differences_deg(self, method: str, axis: int) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return epochs (W,), a sensor's angle (W,), and estimate less sensor (W,) where both are known."""
        reported = next(one for one in self.world.truth.witnesses if np.isfinite(one.attitude_deg[:, axis]).any())
        epochs_us = self.world.ground.epochs_us[self.driven.rows]
        both_us, here, there = np.intersect1d(epochs_us, reported.epochs_us, return_indices=True)
        sensed = reported.attitude_deg[there, axis]
        return both_us, sensed, self.driven.methods[method].estimate_deg[here, axis] - sensed

    def means_deg(self, method: str, axis: int) -> FloatArray:
        """Return the mean of each session, estimate less sensor."""
        epochs_us, _, differences = self.differences_deg(method, axis)
        start_us = self.world.ground.phases["operation"].start_us
        number = ((epochs_us - start_us) / (3.6e9 * SESSION_H)).astype(int)
        return np.array([np.nanmean(differences[number == k]) for k in np.unique(number)])


def published_curve(seed: int = 1, days: float = 1.0, noise_db: float = RMS_DB) -> Curve:
    """Return rows of the printed curve with white noise, and the product's fit."""
    epochs_us = _MINUTE_US * np.arange(round(1440 * days))
    phase = node_phase_rad(epochs_us, np.zeros(1, dtype=np.int64), 3600.0 * PERIOD_H)
    power = evaluate_harmonic(phase, AMPLITUDE_DB, PHASE_RAD) + OFFSET_DBW
    power = power + noise_db * np.random.default_rng(seed).standard_normal(len(power))
    fit = fit_harmonic(phase, power + _DBM)
    fitted = evaluate_harmonic(phase, fit.amplitude_db, fit.phase_rad) + fit.offset_dbm - _DBM
    return Curve(epochs_us / 3.6e9, power, fit, fitted)


def best_period_h(curve: Curve) -> float:
    """Return the period with which the product's fit leaves the least, h."""
    from scipy.optimize import minimize_scalar

    def left_db(period_h: float) -> float:
        phase = node_phase_rad((curve.hours * 3.6e9).astype(np.int64), np.zeros(1, dtype=np.int64), 3600.0 * period_h)
        return fit_harmonic(phase, curve.power_dbw + _DBM, gate_sigma=10.0).rms_db

    return float(minimize_scalar(left_db, bounds=(23.5, 24.5), method="bounded", options={"xatol": 1e-4}).x)


def fly_session(seed: int) -> Session:
    """Return a day of operation of a seed.

    Raises
    ------
    ExportFailedError, UndrivenError
        The simulator wrote no world, or the product refused it.
    """
    world = simulated_world(SCENARIO, seed, OPERATION_DAYS)
    return Session(world, drive(world.ground))


def reproduce(seeds: int, report: Callable[[str], None] = lambda _what: None) -> tuple[list[Row], list[Session]]:
    """Return every row of the table and the sessions behind it."""
    report("daily curve")
    rows = _curve_rows()
    sessions = []
    for seed in range(1, seeds + 1):
        report(f"sessions of seed {seed}")
        sessions.append(fly_session(seed))
    return [*rows, _turn_row(sessions), *_session_rows(sessions)], sessions


def _curve_rows() -> list[Row]:
    """Return the parameters of the curve; what is allowed is three sigma of a fit of so many rows."""
    parameters, curve = "printed curve, its rms as white noise, 1440 rows, seed 1", published_curve()
    period_h = best_period_h(published_curve(days=_PERIOD_DAYS))
    return [
        row("amplitude of the daily curve", parameters, AMPLITUDE_DB, curve.fit.amplitude_db, "dB", within=0.021),
        row("its phase since the ascending node", parameters, PHASE_RAD, curve.fit.phase_rad, "rad", within=0.06),
        row("its level", parameters, OFFSET_DBW, curve.fit.offset_dbm - _DBM, "dBW", within=0.015),
        row("rms of what is left", parameters, RMS_DB, curve.fit.rms_db, "dB", within=0.011),
        row("period that fits best", "the same, ten days", PERIOD_H, period_h, "h", within=0.025),
    ]


def _turn_row(sessions: list[Session]) -> Row:
    """Return the turn about roll that changes a carrier as much as a day does."""
    slopes = [abs(slope) for session in sessions for slope in session.driven.roll_slopes_db_per_deg]
    turn_deg = AMPLITUDE_DB / float(np.median(slopes))
    parameters = f"simulated beams drawn for 1.2 dB/deg, calibrated slopes, median of {len(slopes)}"
    return row("0.35 dB as a turn about roll", parameters, TURN_DEG, turn_deg, "deg", within=0.1, is_fitted=True)


def _session_rows(sessions: list[Session]) -> list[Row]:
    """Return how the means of sessions agree with other sensors."""
    rows = []
    for method in ("paper", "robust"):
        for axis, sensor in ((1, "Earth sensor"), (2, "Earth sensor"), (0, "direction finder")):
            means = np.abs(np.concatenate([session.means_deg(method, axis) for session in sessions]))
            share, what = float(np.mean(means <= AGREEMENT_DEG)), f"{AXES[axis]} beside the {sensor}"
            parameters = f"{method} method, {len(means)} sessions of {SESSION_H:g} h, simulated"
            rows.append(
                statement_row(
                    *(f"{what}: sessions whose mean agrees within 0.1 deg", parameters, "as a rule", share, ""),
                    is_met=share >= RULE_SHARE,
                    is_known_miss=axis == 0,
                )
            )
            largest = (f"{what}: largest mean", parameters, AGREEMENT_DEG, float(means.max()), "deg")
            rows.append(row(*largest, is_bound=True, is_known_miss=axis == 0))
    return rows


#: deg, of the figure's orbit: the paper has no more than this
_LATITUDE_DEG = 0.05
_METHODS = {"paper": "#2ca02c", "robust": "#1f77b4"}


def draw_reproduction(session: Session, folder: Path) -> list[Path]:
    """Draw figures 1, 2 and 3 of the paper as the product gives them into a folder; return their paths."""
    # matplotlib costs a second that only figures need
    import matplotlib as mpl

    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        paths = [_draw_curve(folder / "rf-attitude-figure-1.png")]
        for method, number in (("paper", 2), ("robust", 3)):
            paths.append(_draw_angles(session, method, folder / f"rf-attitude-figure-{number}.png"))
    return paths


def _draw_curve(path: Path) -> Path:
    """Draw powers of two days with the fitted curve, and the latitude of the spacecraft."""
    from matplotlib.figure import Figure

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
    from matplotlib.figure import Figure

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
