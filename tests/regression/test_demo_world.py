"""The demonstration world's published figures and the torque that the ground does not know."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from driven_world import flown_by_paper

from analyzer_sim.export import export_npz
from analyzer_sim.world.scenario.scenario import SCENARIOS
from analyzer_sim.world.world import World
from service.core.estimation.paper.harmonic import fit_harmonic, fit_harmonics
from service.core.geometry.line_of_sight import node_phase_rad
from service.records.levels.attitude import Axes
from service.study.closed_loop import run
from service.study.closed_loop.controllers import LEAD_S, ByTruth, Sensing
from service.study.closed_loop.plant_process import SpacecraftTruth
from service.study.closed_loop.run import UNKNOWN_TORQUE_SCENARIOS, group_merit, run_merit
from service.study.demonstration.control_centre import AXES
from service.study.demonstration.judgement import judge_axis, missed_figures
from service.study.estimation.flight.drive import drive
from service.study.estimation.flight.world import read_world

SEEDS = (1, 2, 3)
#: rows of the first hour: the trailing mean and the first slope must have filled
SETTLING_ROWS = 60


def judge(estimate_deg, truth_deg):
    """Return the figures of each axis after settling."""
    return {
        axis: judge_axis(estimate_deg[SETTLING_ROWS:, k], truth_deg[SETTLING_ROWS:, k]) for k, axis in enumerate(AXES)
    }


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_the_demonstration_meets_its_bounds_and_the_answer_that_never_moves_does_not(seed):
    """Two days of operation, calibrated and aligned by the service itself; one drive serves every claim."""
    day = flown_by_paper(SCENARIOS["demo"], seed)
    merits = judge(day.estimate_deg, day.truth_deg)
    for axis, merit in merits.items():
        figures = " ".join(f"{name} {value:.3f}" for name, value in merit._asdict().items())
        print(f"seed {seed} {axis}: {figures}")
    # the demonstration's own bounds: rms .08 and .10 deg, slope 1 +- .15, truth rms .12 deg on each axis
    assert missed_figures(merits, "paper") == []
    _zero_misses(day)
    _sigma_is_honest(day, seed)
    _commands_agree_with_rows(day, seed)


def _zero_misses(day):
    """The answer 0/0/0 has neither slope nor rms."""
    missed = missed_figures(judge(np.zeros_like(day.truth_deg), day.truth_deg), "paper")
    assert [text.split(" ")[:2] for text in missed] == [
        ["roll", "rms"],
        ["roll", "slope"],
        ["pitch", "rms"],
        ["pitch", "slope"],
    ]


def _sigma_is_honest(day, seed):
    """Errors of roll and pitch are of the size of the row's own sigma."""
    sigma = np.array([row.sigma_deg for row in day.rows])[SETTLING_ROWS:, 1:]
    error = (day.estimate_deg - day.truth_deg)[SETTLING_ROWS:, 1:]
    ratio = np.sqrt(np.nanmean((error / sigma) ** 2, axis=0))
    print(f"seed {seed}: rms of error over own sigma, roll {ratio[0]:.2f} pitch {ratio[1]:.2f}")
    # what the levels wandered since the alignment and the lag of a quarter-hour mean are not in a snapshot's
    # covariance: up to three times its sigma
    assert (ratio < 3.0).all()
    assert (ratio > 0.3).all()


def _commands_agree_with_rows(day, seed):
    """A command is zero exactly where it says why, and repeats every reason of its row."""
    allowed = np.array([row.control_allowed for row in day.rows])[SETTLING_ROWS:]
    print(f"seed {seed}: control allowed in {allowed.mean():.3f} of the rows")
    # nothing in this story forbids control but rain on three users, which the fix leaves out
    assert allowed.mean() >= 0.9
    for row, command in zip(day.rows, day.commands, strict=True):
        assert command.control_allowed == (not command.inhibitions)
        assert command.control_allowed or not any(command.torque_n_m)
        assert row.control_allowed or set(row.inhibitions) <= set(command.inhibitions)


@pytest.mark.slow
def test_the_robust_method_meets_its_bounds_in_the_demonstrations_world(tmp_path):
    """Seed 4; seed 1 is the demonstration's own."""
    path = tmp_path / "demo.npz"
    export_npz(World(SCENARIOS["demo"], 4), path)
    world = read_world(path)
    driven = drive(world.ground)
    truth = world.truth.attitude_deg[driven.rows]
    merits = judge(driven.methods["robust"].estimate_deg, truth)
    print({axis: tuple(round(float(value), 3) for value in merit) for axis, merit in merits.items()})
    assert missed_figures(merits, "robust") == []
    zeros = judge(np.zeros_like(truth), truth)
    assert {text.split(" ")[0] for text in missed_figures(zeros, "robust")} == {"yaw", "roll", "pitch"}


SEED = 2
SHORT_DAYS = 0.25
#: one at every run, both in continuous integration
ONE_AND_OTHERS = ("unknown_residual_daily", pytest.param("unknown_residual_constant", marks=pytest.mark.nightly))
TURN_DEG_S = np.degrees(7.292115e-5)


@dataclass
class ByCorrections:
    """The law on angles that the spacecraft's own commands tell: powers are not looked at."""

    law: ByTruth
    epoch_us: int = 0
    angles_deg: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rates_deg_s: np.ndarray = field(default_factory=lambda: np.zeros(3))
    sent: list = field(default_factory=list)

    def decide(self, measurement, truth):
        step_s = (measurement.epoch_us - self.epoch_us) / 1e6 if self.epoch_us else 0.0
        due = [pulse for pulse in self.sent if pulse.start_us < measurement.epoch_us]
        self.sent = [pulse for pulse in self.sent if pulse not in due]
        inertia = np.diag(self.law.spacecraft.inertia_kg_m2)[[2, 0, 1]]
        for pulse in due:
            self.rates_deg_s += np.degrees(np.array(pulse.torque_n_m) * pulse.duration_s / inertia)
        yaw, roll, _ = self.angles_deg * np.radians(TURN_DEG_S)
        self.angles_deg += step_s * (self.rates_deg_s + np.array([-roll, yaw, 0.0]))
        self.epoch_us = measurement.epoch_us
        believed = SpacecraftTruth(measurement.epoch_us, Axes(*self.angles_deg), Axes(*self.rates_deg_s), 0.0)
        decision = self.law.decide(measurement, believed)
        self.sent += decision.schedule
        return decision

    def on_ground(self, content):
        """Ignore it."""

    def on_input(self, reports):
        """Take every command as carried out."""


def flown(name, seed, days, sensing=Sensing.AUTOMATIC):
    result = run.fly_unit(run.LoopUnit(name, seed, sensing, operation_days=days))
    merit = run_merit(result.flight)
    print(f"{name} seed {seed} {sensing}: {merit.largest_deg}, inhibited {merit.longest_inhibited_h:.2f} h at a time")
    return result, merit


@pytest.mark.slow
@pytest.mark.parametrize("name", ONE_AND_OTHERS)
def test_control_goes_on_and_learns_the_torque(name):
    result, merit = flown(name, SEED, SHORT_DAYS)
    assert merit.is_unknown_torque_survived
    assert result.flight.sent > 15


def stating(residual_n_m):
    """Return how a spacecraft is flown whose catalogue states a torque."""
    kept = run.flown_spacecraft

    def stated(record, release):
        reported = kept(record, release)
        return replace(reported, onboard=replace(reported.onboard, residual_torque_n_m=residual_n_m))

    return stated


@pytest.mark.slow
def test_where_the_catalogue_says_that_there_is_none_it_is_found_and_roll_and_pitch_are_held(monkeypatch):
    monkeypatch.setattr(run, "flown_spacecraft", stating(0.0))
    _, merit = flown("unknown_residual_constant", SEED, SHORT_DAYS)
    assert merit.longest_inhibited_h < 0.5
    assert max(merit.largest_deg[1:]) < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("name", ONE_AND_OTHERS)
def test_trivial_answers_miss(name, monkeypatch):
    """Nothing, and corrections that are computed from corrections alone."""
    _, nothing = flown(name, SEED, SHORT_DAYS, Sensing.OFF)

    def by_corrections(unit, ground, *_):
        aligned_deg = np.nanmean(ground.references[0].attitude_deg[-60:], axis=0)
        return ByCorrections(ByTruth(ground.spacecraft, LEAD_S, 60.0), angles_deg=aligned_deg)

    monkeypatch.setattr(run, "controller_of", by_corrections)
    _, blind = flown(name, SEED, SHORT_DAYS)
    for merit in (nothing, blind):
        assert max(merit.largest_deg[1:]) > 0.3
        assert not merit.is_unknown_torque_survived


@pytest.mark.nightly
@pytest.mark.parametrize("name", UNKNOWN_TORQUE_SCENARIOS)
def test_twenty_seeds_of_a_day(name):
    results = [flown(name, seed, None)[0] for seed in range(1, 21)]
    reported = group_merit(results)
    yaw_deg = [run_merit(result.flight).largest_deg[0] for result in results]
    print(f"{name}: {reported.largest_deg}, yaw within 1 deg in {sum(size < 1.0 for size in yaw_deg)} of 20")
    assert reported.longest_inhibited_h <= 0.25
    assert max(reported.largest_deg[-1][1:]) < 0.3
    # asked are 1.0 deg in all runs; what powers tell of yaw reaches that in most (docs/evidence/closed-loop.md)
    assert max(yaw_deg) < 2.0
    assert sum(size < 1.0 for size in yaw_deg) >= 12


AMPLITUDE_DB, PHI_RAD, OFFSET_DBM, RMS_DB = 0.3489, -0.6178, -72.8866 + 30.0, 0.1857
PERIOD_S = 23.98 * 3600.0
PERIOD_US = 86_328_000_000
NODE_US = 1_384_700_000_000_000  # a node in November 2013, the month of the paper
EPOCHS_US = NODE_US + 60_000_000 * np.arange(1440)
PHASE_RAD = node_phase_rad(EPOCHS_US, np.array([NODE_US]), PERIOD_S)


def power_dbm(phi_rad=PHI_RAD):
    return AMPLITUDE_DB * np.cos(PHASE_RAD + phi_rad) + OFFSET_DBM


def test_the_published_figures_come_back_to_nine_digits():
    fit = fit_harmonic(PHASE_RAD, power_dbm())
    assert fit.amplitude_db == pytest.approx(AMPLITUDE_DB, abs=1e-9)
    assert fit.phase_rad == pytest.approx(PHI_RAD, abs=1e-9)
    assert fit.offset_dbm == pytest.approx(OFFSET_DBM, abs=1e-9)
    assert fit.rms_db < 1e-9
    assert (fit.samples_used, fit.samples_rejected, fit.converged) == (1440, 0, True)


@pytest.mark.parametrize("phi_rad", [-0.6178, 0.6178, math.pi - 0.6178, 0.6178 - math.pi])
def test_all_four_quadrants_of_phi(phi_rad):
    assert fit_harmonic(PHASE_RAD, power_dbm(phi_rad)).phase_rad == pytest.approx(phi_rad, abs=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_the_published_noise_leaves_the_figures_within_three_sigmas(seed):
    print("seed", seed)
    noise_db = RMS_DB * np.random.default_rng(seed).standard_normal(1440)
    fit = fit_harmonic(PHASE_RAD, power_dbm() + noise_db)
    # 3 sigma: 0.1857 sqrt(2 / 1440), that over 0.3489, 0.1857 / sqrt(1440), 0.1857 / sqrt(2880)
    assert fit.amplitude_db == pytest.approx(AMPLITUDE_DB, abs=0.021)
    assert fit.phase_rad == pytest.approx(PHI_RAD, abs=0.06)
    assert fit.offset_dbm == pytest.approx(OFFSET_DBM, abs=0.015)
    assert fit.rms_db == pytest.approx(RMS_DB, abs=0.011)
    assert fit.converged


def test_the_claimed_errors_are_honest():
    noise_db = RMS_DB * np.random.default_rng(99).standard_normal((1440, 400))
    fits = fit_harmonics(PHASE_RAD, power_dbm()[:, None] + noise_db)
    spread_db = np.std(fits.offset_dbm)
    claimed_db = np.sqrt(fits.covariance[:, 0, 0].mean())
    # a standard deviation of 400 draws is good to 3.5 per cent; the gate takes 1.3 per cent off the claim; four sigmas
    assert claimed_db == pytest.approx(spread_db, rel=0.15)


@pytest.mark.parametrize("periods", [-30, 1, 365])
def test_whole_nodal_periods_change_nothing(periods):
    fit = fit_harmonic(PHASE_RAD, power_dbm())
    moved_rad = node_phase_rad(EPOCHS_US + periods * PERIOD_US, np.array([NODE_US]), PERIOD_S)
    moved = fit_harmonic(moved_rad, power_dbm())
    assert moved.amplitude_db == pytest.approx(fit.amplitude_db, abs=1e-9)
    assert moved.phase_rad == pytest.approx(fit.phase_rad, abs=1e-9)
    assert moved.offset_dbm == pytest.approx(fit.offset_dbm, abs=1e-9)
