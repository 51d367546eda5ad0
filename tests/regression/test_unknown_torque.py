"""Closed loops under a torque that the catalogue does not know, against the plant, over the link; ADR 0007.

Figures as in docs/evidence/closed-loop.md: `soo study closed-loop --scenario unknown_residual_constant --scenario
unknown_residual_daily --sensing automatic --runs 20`.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from service.records.levels.attitude import Axes
from service.records.levels.measurement import Measurement
from service.study.closed_loop import run
from service.study.closed_loop.controllers import LEAD_S, ByTruth, ControllerOutput, Sensing
from service.study.closed_loop.merit import UNKNOWN_TORQUE_SCENARIOS, group_merit, run_merit
from service.study.closed_loop.plant_process import CommandReport, SpacecraftTruth

SEED = 2
SHORT_DAYS = 0.25
#: one at every run, both in continuous integration
ONE_AND_OTHERS = ("unknown_residual_daily", pytest.param("unknown_residual_constant", marks=pytest.mark.slow))
TURN_DEG_S = np.degrees(7.292115e-5)


@dataclass
class ByCorrections:
    """The law on angles that the spacecraft's own commands tell: powers are not looked at."""

    law: ByTruth
    epoch_us: int = 0
    angles_deg: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rates_deg_s: np.ndarray = field(default_factory=lambda: np.zeros(3))
    sent: list = field(default_factory=list)

    def decide(self, measurement: Measurement, truth: SpacecraftTruth, counter: int) -> ControllerOutput:
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
        decision = self.law.decide(measurement, believed, counter)
        self.sent += decision.schedule
        return decision

    def on_input(self, reports: tuple[CommandReport, ...]) -> None:
        """Take every command as carried out."""


def flown(name, seed, days, sensing=Sensing.AUTOMATIC):
    result = run.fly_unit(run.LoopUnit(name, seed, sensing, operation_days=days))
    merit = run_merit(result.flight)
    print(f"{name} seed {seed} {sensing}: {merit.largest_deg}, inhibited {merit.longest_inhibited_h:.2f} h at a time")
    return result, merit


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
def test_where_the_catalogue_says_that_there_is_none_control_is_lost(monkeypatch):
    """The default of before: the spacecraft is left to the torque by the reason that its motion was not announced."""
    monkeypatch.setattr(run, "flown_spacecraft", stating(0.0))
    _, merit = flown("unknown_residual_constant", SEED, SHORT_DAYS)
    assert merit.longest_inhibited_h > 0.5
    assert not merit.is_unknown_torque_survived


@pytest.mark.slow
@pytest.mark.parametrize("name", UNKNOWN_TORQUE_SCENARIOS)
def test_trivial_answers_miss(name, monkeypatch):
    """Nothing, and corrections that are computed from corrections alone."""
    _, nothing = flown(name, SEED, SHORT_DAYS, Sensing.OFF)

    def by_corrections(unit, ground, documents, plan):
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
