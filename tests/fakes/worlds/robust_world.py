"""The attitude filter over worlds of the simulator, apart from errors of calibration.

Patterns are fitted to the simulator's own payload, the harmonic is the true one, references and noise are learned from
the quiet phase: what remains is the filter's own doing. The truth stays with the judge.
"""

from dataclasses import dataclass

import numpy as np
from filter_rows import step
from scipy.optimize import nnls
from simulated_gain import attitude_gain_db

from analyzer_sim.export import measured_dbm
from analyzer_sim.world.payload.level_terms import dishes_loss_db, nominal_gain_db
from analyzer_sim.world.world import World
from service.core.estimation.filtering.filter_model import (
    CarrierModel,
    FilterSettings,
    KnownMotion,
    initial_gaussian,
    no_motion,
)
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.plant import filter_model
from service.core.estimation.filtering.row_block import Declared, nothing_declared

#: correlation times that the learned noise may have, s
TAUS_S = (300.0, 1200.0, 7200.0, 36000.0)
AXES = ("yaw", "roll", "pitch")
SETTLING_ROWS = 60
#: an eclipse, during it and for an hour after: gains of the transponders and levels of the carriers, dB/sqrt(h)
ECLIPSE_GAIN_DB, ECLIPSE_LEVEL_DB, WARMING_US = 0.4, 0.06, 3_600_000_000
#: declared work on a carrier, a transponder, the chain, dB, and the chain's walk meanwhile, dB/sqrt(h)
WORK_DB = 2.0
CHAIN_WALK_DB = 0.1
#: what a level that nobody touches may still wander beyond the learned noise, dB/sqrt(h)
REFERENCE_WALK_DB = 0.002
#: as many independent values of its noise count as much as the other carriers' example
SHRINKAGE = 6.0
#: sigma of the attitude at the alignment, deg: an hour of a star tracker
ALIGNED_SIGMA_DEG = np.array([0.004, 0.002, 0.002])


@dataclass(frozen=True)
class Filtered:
    """What the filter made of the operation phase of one world."""

    #: (T, 3) deg
    truth_deg: np.ndarray
    estimate_deg: np.ndarray
    sigma_deg: np.ndarray
    #: (T, 3) whether control may use the axis
    is_allowed: np.ndarray
    is_raining: np.ndarray
    #: (T,) dB, truth
    fade_db: np.ndarray
    #: (T, N) whether a carrier was used, and what was wrong with it in truth
    is_used: np.ndarray
    flags: np.ndarray
    nis: np.ndarray
    causes: list
    steps: list

    def judged(self) -> dict[str, object]:
        """Return the figures of section 7 after an hour of settling."""
        error = (self.estimate_deg - self.truth_deg)[SETTLING_ROWS:]
        truth, sigma = self.truth_deg[SETTLING_ROWS:], self.sigma_deg[SETTLING_ROWS:]
        allowed = self.is_allowed[SETTLING_ROWS:]
        wrong = (np.abs(error) > np.array([0.3, 0.15, 0.15])) & allowed
        dry = self.fade_db[SETTLING_ROWS:] <= 0.0
        return {
            "rms": np.sqrt((error**2).mean(0)),
            "p95": np.quantile(np.abs(error), 0.95, axis=0),
            "truth": np.sqrt((truth**2).mean(0)),
            "skill": 1.0 - (error**2).mean(0) / (truth**2).mean(0),
            "ratio": np.sqrt((error**2).mean(0) / (sigma**2).mean(0)),
            "wrong_yaw": int(wrong[:, 0].sum()),
            "wrong_roll_pitch": int(wrong[:, 1:].any(axis=1).sum()),
            "available": float(allowed[dry, 1].mean()),
            "yaw_available": float(allowed[dry, 0].mean()),
        }


def quadratic_patterns(world: World) -> tuple[np.ndarray, np.ndarray]:
    """Return gradient (N, 3) and Hessian (N, 3, 3) fitted to the payload over 0.4 deg around nominal."""
    grid = np.array(np.meshgrid(*[np.linspace(-0.4, 0.4, 5)] * 3)).reshape(3, -1).T
    gain = nominal_gain_db(world.plan, world.orbit, grid) - nominal_gain_db(world.plan, world.orbit, np.zeros((1, 3)))
    pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    design = np.column_stack([grid, *[grid[:, a] * grid[:, b] * (0.5 if a == b else 1.0) for a, b in pairs]])
    fit = np.linalg.lstsq(design, gain, rcond=None)[0]
    hessian = np.empty((gain.shape[1], 3, 3))
    for number, (a, b) in enumerate(pairs):
        hessian[:, a, b] = hessian[:, b, a] = fit[3 + number]
    return fit[:3].T, hessian


def learned_noise(residual_db: np.ndarray, row_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return white (N,) and coloured (N, K) sigmas that explain the autocovariance of residuals (T, N)."""
    own = residual_db - np.median(residual_db, axis=1, keepdims=True)
    own = own - own.mean(axis=0)
    count = len(own)
    lags = np.unique(np.geomspace(1, count // 4, 24).astype(int))
    white, coloured = [], []
    # a window of T takes (2 tau / T) of a slow part away with its mean; the fit puts it back
    for series in own.T:
        covariance = [float(series @ series) / count]
        covariance += [float(series[lag:] @ series[:-lag]) / (count - lag) for lag in lags]
        design = np.zeros((len(lags) + 1, len(TAUS_S) + 1))
        design[0, 0] = 1.0
        times = np.concatenate([[0], lags]) * row_s
        for number, tau in enumerate(TAUS_S):
            span = count * row_s / tau
            lost = 2.0 * (span - 1.0 + np.exp(-span)) / span**2
            design[:, number + 1] = np.exp(-times / tau) - lost
        weight = 1.0 / np.sqrt(1.0 + np.arange(len(times)) ** 1.0)
        fit, _ = nnls(design * weight[:, None], np.array(covariance) * weight)
        white.append(np.sqrt(max(fit[0], 0.03**2)))
        coloured.append(fit[1:])
    return np.array(white), np.sqrt(np.maximum(shrunk(np.array(coloured), count * row_s), 0.005**2))


def shrunk(variance: np.ndarray, span_s: float) -> np.ndarray:
    """Return variances (N, K) drawn to those of all carriers as far as a span cannot tell them one by one.

    A span of three days holds seven times a part of ten hours: alone it says little more than the size of it.
    """
    usual = np.sort(variance, axis=0)[: len(variance) - len(variance) // 8].mean(axis=0)
    known = span_s / (2.0 * np.array(TAUS_S))
    weight = known / (known + SHRINKAGE)
    return weight * variance + (1.0 - weight) * usual


def level_sigma_db(white_db: np.ndarray, coloured_db: np.ndarray, row_s: float, rows: int) -> np.ndarray:
    """Return what noise leaves uncertain (N,) about a level and its day, fitted to a quiet phase of so many rows."""
    spans = rows * row_s / np.array(TAUS_S)
    mean = 2.0 * (spans - 1.0 + np.exp(-spans)) / spans**2
    # level, cosine and sine: three times the variance of a mean, for the slow parts less
    return np.sqrt(3.0 * (white_db**2 / rows + coloured_db**2 @ mean))


class RobustWorld:
    """One world with everything a filter is told, errors of calibration left out."""

    def __init__(self, scenario, seed: int) -> None:
        self.world = world = World(scenario, seed)
        epochs_us, row_s = world.rows.epochs_us, scenario.row_period_s
        zeros = np.zeros((len(epochs_us), 3))
        harmonic_db = attitude_gain_db(world.plan, world.orbit, epochs_us, zeros)
        harmonic_db = harmonic_db - dishes_loss_db(world.plan, world.orbit, epochs_us, seed)
        levels = np.array([carrier.level_dbm for carrier in world.plan.carriers])
        self.deviation_db = measured_dbm(world) - levels - harmonic_db
        gradient, hessian = quadratic_patterns(world)
        operation_us = scenario.operation_start_us
        self.first = int(np.searchsorted(epochs_us, operation_us))
        quiet = epochs_us < scenario.phases[0].stop_us
        truth = world.rows.attitude_deg[quiet]
        patterns = truth @ gradient.T + 0.5 * np.einsum("ti,nij,tj->tn", truth, hessian, truth)
        residual_db = self.deviation_db[quiet] - patterns
        kept = np.isfinite(residual_db).all(axis=1)
        slow_db = self._daily_db(residual_db[kept], epochs_us[quiet][kept])
        residual_db = (residual_db - slow_db[quiet])[kept]
        self.deviation_db = self.deviation_db - slow_db
        white, coloured = learned_noise(residual_db, row_s)
        count, labels = len(levels), sorted({c.transponder for c in world.plan.carriers})
        self.model = CarrierModel(
            gradient,
            hessian,
            world.plan.rain_share,
            np.array([labels.index(c.transponder) for c in world.plan.carriers]),
            white,
            coloured,
            np.tile(TAUS_S, (count, 1)),
            np.full(count, REFERENCE_WALK_DB),
            np.empty(0),
            np.empty(0),
            np.zeros((count, 9, 9)),
        )
        self.reference_sigma_db = level_sigma_db(white, coloured, row_s, int(kept.sum()))

    def _daily_db(self, residual_db: np.ndarray, epochs_us: np.ndarray) -> np.ndarray:
        """Return level and solar day (T, N) of every carrier, fitted to the quiet phase and carried on."""
        all_us = self.world.rows.epochs_us
        day = 2.0 * np.pi * (all_us - all_us[0]) / 86_400e6
        design = np.column_stack([np.ones(len(day)), np.cos(day), np.sin(day)])
        return design @ np.linalg.lstsq(design[np.isin(all_us, epochs_us)], residual_db, rcond=None)[0]

    def known_motion(self) -> list[KnownMotion]:
        """Return what the ground was told about each step of the operation phase."""
        epochs_us = self.world.rows.epochs_us[self.first - 1 :]
        total = np.zeros((len(epochs_us), 3))
        for correction in self.world.corrections:
            share = (np.clip(epochs_us, correction.start_us, correction.stop_us) - correction.start_us) / (
                correction.stop_us - correction.start_us
            )
            total += share[:, None] * np.array(correction.attitude_deg)
        zeros = np.zeros(3)
        return [KnownMotion(row, zeros, zeros) for row in np.diff(total, axis=0)]

    def declared(self, from_us: int, to_us: int) -> Declared | None:
        """Return what the ground declared about a step, None where there was nothing."""
        plan, labels = self.world.plan, sorted({c.transponder for c in self.world.plan.carriers})
        effect = nothing_declared(len(plan.carriers), len(labels))
        changed, hours = effect, (to_us - from_us) / 3.6e9
        for operation in self.world.operations:
            named = np.array([operation.carriers is None or c.id in operation.carriers for c in plan.carriers])
            groups = np.array([operation.transponders is None or name in operation.transponders for name in labels])
            is_edge = from_us < operation.start_us <= to_us or from_us < operation.stop_us <= to_us
            is_on = operation.start_us <= to_us < operation.stop_us
            if operation.kind == "eclipse" and operation.start_us <= to_us < operation.stop_us + WARMING_US:
                changed = changed._replace(
                    group_step_db=np.full(len(labels), ECLIPSE_GAIN_DB * np.sqrt(hours)),
                    reference_walk_db=np.full(len(named), ECLIPSE_LEVEL_DB),
                )
            elif operation.kind in ("carrier_work", "sun_outage"):
                changed = changed._replace(is_masked=changed.is_masked | (named & is_on))
                if is_edge and operation.kind == "carrier_work":
                    changed = changed._replace(reference_step_db=np.maximum(effect.reference_step_db, WORK_DB * named))
            elif operation.kind == "gain_change" and is_edge:
                changed = changed._replace(group_step_db=np.maximum(changed.group_step_db, WORK_DB * groups))
            elif operation.kind == "receive_chain_work" and (is_edge or is_on):
                changed = changed._replace(chain_walk_db=CHAIN_WALK_DB, chain_step_db=WORK_DB * is_edge)
        return None if changed is effect else changed

    def drive(self, settings: FilterSettings | None = None, model: CarrierModel | None = None) -> Filtered:
        """Run the filter over the operation phase."""
        settings, model = settings or FilterSettings(), model or self.model
        rows, known = self.world.rows, self.known_motion()
        aligned = rows.attitude_deg[self.first - 1]
        gaussian = initial_gaussian(
            model, aligned, ALIGNED_SIGMA_DEG, self.reference_sigma_db, drift_deg_h=settings.drift_deg_h
        )
        state = start(model, int(rows.epochs_us[self.first - 1]), gaussian)
        compiled = filter_model(model, settings)
        steps, pending, written = [], no_motion(), []
        for k in range(self.first, len(rows.epochs_us)):
            moved = known[k - self.first]
            pending = KnownMotion(pending.correction_deg + moved.correction_deg, np.zeros(3), np.zeros(3))
            if rows.is_gap[k]:
                continue
            epoch_us = int(rows.epochs_us[k])
            declared = self.declared(state.epoch_us, epoch_us) if self.world.operations else None
            reported = step(compiled, state, epoch_us, self.deviation_db[k], pending, declared=declared)
            state, pending = reported.state, no_motion()
            steps.append(reported)
            written.append(k)
        used = np.zeros((len(steps), model.carriers), dtype=bool)
        for number, reported in enumerate(steps):
            used[number, reported.used] = True
        return Filtered(
            rows.attitude_deg[written],
            np.array([reported.attitude_deg for reported in steps]),
            np.array([reported.sigma_deg for reported in steps]),
            np.array([reported.integrity.is_axis_allowed for reported in steps]),
            np.array([bool(reported.state.watch["is_raining"][0]) for reported in steps]),
            rows.downlink_fade_db[written],
            used,
            rows.flags[written],
            np.array([float(reported.state.watch["nis_ratio"][0]) for reported in steps]),
            [reported.cause for reported in steps],
            steps,
        )
