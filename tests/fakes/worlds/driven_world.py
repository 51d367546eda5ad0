"""The whole product over one world of the simulator: calibrated by geometry, aligned, then flown as often as a test
likes, each time with powers that the test has changed.

The simulator writes its file and the product reads it as a study does. All flights of a world see the same noise, so
that two of them differ by what was changed and by nothing else.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from kept_results import kept
from simulated_gain import attitude_gain_db

from analyzer_sim.export import export_arrays
from analyzer_sim.world.payload.level_terms import dishes_loss_db
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World
from service.pipeline.chain import Chain
from service.pipeline.config import ChainConfig
from service.pipeline.inputs.knowledge import JournalDocuments
from service.records.calibration import Alignment, CalibrationMethod, Window
from service.records.catalogue import ControlMode, ControlSettings, Method, Release, Spacecraft
from service.records.inputs import (
    AlignmentSet,
    CalibrationActivation,
    EphemerisChange,
    PlanChange,
    SpacecraftChange,
)
from service.records.levels.attitude import AttitudeRow, BoolArray, FloatArray, IntArray, Status, TorqueCommand
from service.records.levels.measurement import Measurement
from service.study.estimation.flight.drive import align, calibrate, measurements, slow_entries
from service.study.estimation.flight.world import Ground, read_world

HOUR_US = 3_600_000_000
ROBUST_ONLY = (Method.ROBUST,)
DEFAULTS = ChainConfig()


@dataclass(frozen=True)
class Flown:
    """What one method said of T rows of operation."""

    rows: list[AttitudeRow]
    #: (T,) since the start of operation
    hours: FloatArray
    #: (T, 3) deg, yaw, roll, pitch
    truth_deg: FloatArray
    #: of the law, as the spacecraft's control asks for them
    commands: list[TorqueCommand | None]
    #: (T,) dB, truth
    downlink_fade_db: FloatArray

    @cached_property
    def estimate_deg(self) -> FloatArray:
        """Angles (T, 3), NaN = none."""
        return np.array([row.attitude_deg for row in self.rows])

    @cached_property
    def sigma_deg(self) -> FloatArray:
        """One standard deviation (T, 3) of the angles."""
        return np.array([row.sigma_deg for row in self.rows])

    @cached_property
    def error_deg(self) -> FloatArray:
        """Angles less the truth (T, 3)."""
        return self.estimate_deg - self.truth_deg

    @cached_property
    def is_allowed(self) -> BoolArray:
        """Where (T,) control is allowed."""
        return np.array([row.control_allowed for row in self.rows])

    @cached_property
    def is_fade(self) -> BoolArray:
        """Where (T,) rain over the receiving site is told."""
        return np.array([row.downlink_fade for row in self.rows])

    def says(self, inhibition: str) -> BoolArray:
        """Return where (T,) control is forbidden for this reason."""
        return np.array([inhibition in row.inhibitions for row in self.rows])

    def advises(self, advice: str) -> BoolArray:
        """Return where (T,) the operator is advised so."""
        return np.array([advice in row.advice for row in self.rows])

    def between(self, begin_h: float, end_h: float = np.inf) -> BoolArray:
        """Return which rows (T,) lie in an interval."""
        return np.asarray((self.hours >= begin_h) & (self.hours < end_h))

    def rms_deg(self, begin_h: float, end_h: float = np.inf) -> FloatArray:
        """Return the root mean square of the errors (3,) in an interval."""
        return np.asarray(np.sqrt(np.mean(self.error_deg[self.between(begin_h, end_h)] ** 2, axis=0)))

    @property
    def wrong_minutes(self) -> int:
        """Minutes with control allowed while roll or pitch is off by more than 0.15 deg."""
        return int(np.count_nonzero((np.abs(self.error_deg[:, 1:]) > 0.15).any(axis=1) & self.is_allowed))

    def shift_deg(self, other: "Flown", begin_h: float, end_h: float = np.inf) -> FloatArray:
        """Return by how much (3,) two flights of one noise are apart at most in an interval; both begin together."""
        count = min(len(self.rows), len(other.rows))
        apart_deg = np.abs(self.estimate_deg[:count] - other.estimate_deg[:count])
        return np.asarray(apart_deg[self.between(begin_h, end_h)[:count]].max(axis=0))


def tolerated_deg(plain_deg: FloatArray) -> FloatArray:
    """Return the rms that a bad sensor may lead to, by that without any: a quarter more, or what seeds scatter by."""
    return np.maximum(1.25 * plain_deg, plain_deg + np.array([0.02, 0.003, 0.005]))


class DrivenWorld:
    """One world, calibrated and aligned by the product.

    Parameters
    ----------
    scenario : Scenario
        What the simulator tells.
    seed : int
        Seed of all its streams.
    directory : Path
        Where the simulator's file goes.
    sweep_noise : float
        Scale of the noise of a sweep; 0 with a scenario without noise makes powers without any.
    order : sequence of int, optional
        Order in which the plan names the carriers.
    by : CalibrationMethod
        Kind of the calibration.
    """

    def __init__(
        self,
        scenario: Any,
        seed: int,
        directory: Path,
        sweep_noise: float = 1.0,
        order: Iterable[int] | None = None,
        by: CalibrationMethod = CalibrationMethod.GEOMETRY,
    ) -> None:
        self._by = by
        self.simulated = World(scenario, seed)
        path = directory / f"{scenario.name}-{seed}.npz"
        # as a user exports it, less the compression: an eighth of the time of a world
        np.savez(path, **export_arrays(self.simulated, sweep_noise))
        ground, self.truth = (reported := read_world(path)).ground, reported.truth
        if order is not None:
            ground = replace(ground, carriers=tuple(ground.carriers[k] for k in order))
        self.adopt(ground)

    def adopt(self, ground: Ground) -> None:
        """Calibrate and align with what a ground knows and measured."""
        self.ground = ground
        self.start_us = self.ground.phases["operation"].start_us
        self.documents = JournalDocuments()
        self.documents.add_plan(self.ground.carriers)
        self.documents.add_ephemeris(self.ground.ephemeris)
        self.documents.calibrations[1] = calibrate(
            self.ground, self.documents.plans[1], self.documents.ephemerides[1], self._by
        )
        self.align(self.ground.phases["alignment"])

    @property
    def hours(self) -> FloatArray:
        """Time of every row of the world (T,) since the start of operation."""
        return np.asarray((self.ground.epochs_us - self.start_us) / HOUR_US)

    @cached_property
    def plain(self) -> Flown:
        """The flight in which nothing is changed."""
        return self.fly()

    def align(self, window: Window, number: int = 1) -> Alignment:
        """Keep and return the alignment made over a window in which the sensor told the attitude."""
        ground = replace(self.ground, phases={**self.ground.phases, "alignment": window})
        made = self.documents.alignments[number] = replace(align(ground, self.documents), id=number)
        return made

    def changed(self, begin_h: float, end_h: float, change_db: Any, carriers: Any = slice(None)) -> FloatArray:
        """Return the powers of the world with something added in an interval; NaN takes carriers off the air."""
        power_dbm = self.ground.power_dbm.copy()
        rows = np.flatnonzero((self.hours >= begin_h) & (self.hours < end_h))
        block = power_dbm[rows]
        block[:, carriers] += change_db
        power_dbm[rows] = block
        return power_dbm

    def aligned_chain(
        self,
        documents: JournalDocuments,
        number: int = 1,
        methods: Any = ROBUST_ONLY,
        config: ChainConfig = DEFAULTS,
        spacecraft: Spacecraft | None = None,
    ) -> Chain:
        """Return a chain that has heard everything up to an alignment."""
        chain = Chain(documents, config, methods=methods)
        reported = [entry.content for entry in slow_entries(self.ground, documents) if entry.epoch_us < self.start_us]
        opening = (SpacecraftChange(spacecraft or self.ground.spacecraft, 1), PlanChange(1), EphemerisChange(1))
        for content in (*opening, CalibrationActivation(1, 1), *reported, AlignmentSet(number)):
            chain.update(content)
        return chain

    def fly(
        self, power_dbm: FloatArray | None = None, *, until_h: float = np.inf, method: Method = Method.ROBUST
    ) -> Flown:
        """Return what a method says of the rows of operation, of these powers if they are given."""
        ground = self.ground
        if power_dbm is not None:
            # as the archive keeps them
            ground = replace(ground, power_dbm=power_dbm.astype(np.float32).astype(np.float64))
        return self.fly_ground(ground, until_h=until_h, method=method)

    def fly_ground(
        self,
        ground: Ground,
        *,
        until_h: float = np.inf,
        method: Method = Method.ROBUST,
        config: ChainConfig = DEFAULTS,
    ) -> Flown:
        """Return what a method says of the rows of operation of a ground; no flight may acquire what is no angle."""
        kept = self.documents
        documents = JournalDocuments(dict(kept.plans), dict(kept.ephemerides), kept.calibrations, kept.alignments)
        chain = self.aligned_chain(documents, methods=(method,), config=config, spacecraft=ground.spacecraft)
        entries = [entry for entry in slow_entries(ground, documents) if entry.epoch_us >= self.start_us]
        rows = np.flatnonzero(ground.is_measured & (self.hours >= 0.0) & (self.hours < until_h))
        outcomes = [chain.step(row) for row in measurements(chain, ground, documents, entries, rows)]
        told = [outcome for outcome in outcomes if outcome is not None]
        reported = [row for outcome in told for row in outcome.rows]
        assert len(reported) == len(rows), "one method says one thing about every row"
        assert all(row.status is not Status.ACQUIRED or np.isfinite(row.attitude_deg).all() for row in reported)
        commands = [outcome.command for outcome in told]
        truth = self.truth
        return Flown(reported, self.hours[rows], truth.attitude_deg[rows], commands, truth.downlink_fade_db[rows])

    def snapshot(
        self, number: int, epoch_us: int, power_dbm: FloatArray, method: Method = Method.ROBUST
    ) -> AttitudeRow:
        """Return the fix of one row alone, as a late row gets it, under an alignment."""
        chain = self.aligned_chain(self.documents, number, (method,))
        source = self.ground.source_names[0]
        outcome = chain.step(Measurement(epoch_us, epoch_us, 1, source, 1, power_dbm, None, is_late=True))
        assert outcome is not None
        return outcome.rows[0]

    def noise_free_dbm(self, epochs_us: IntArray, attitude_deg: FloatArray) -> FloatArray:
        """Return the simulator's powers (T, N) without noise, at the levels of its plan."""
        plan, orbit = self.simulated.plan, self.simulated.orbit
        levels = np.array([carrier.level_dbm for carrier in plan.carriers])
        gain_db = attitude_gain_db(plan, orbit, epochs_us, attitude_deg)
        return np.asarray(levels + gain_db - dishes_loss_db(plan, orbit, epochs_us, self.simulated.seed))


@cache
def shared_world(name: str, seed: int, operation_days: float = 0.5) -> DrivenWorld:
    """Return a world of the catalogue; tests of one process share its calibration, so none may change it."""
    return kept(_made, name, seed, operation_days)


def _made(name: str, seed: int, operation_days: float) -> DrivenWorld:
    with TemporaryDirectory() as directory:
        return DrivenWorld(scenario_named(name, operation_days=operation_days), seed, Path(directory))


def flown_by_paper(scenario: Any, seed: int, config: ChainConfig = DEFAULTS) -> Flown:
    """Return what the published method says of a world and commands; calibrated and flown once for all tests."""
    return kept(_flown_by_paper, scenario, seed, config)


def _flown_by_paper(scenario: Any, seed: int, config: ChainConfig) -> Flown:
    with TemporaryDirectory() as directory:
        world = DrivenWorld(scenario, seed, Path(directory), by=CalibrationMethod.PAPER)
    control = ControlSettings(Method.PAPER, ControlMode.GROUND, Release.AUTOMATIC)
    ground = replace(world.ground, spacecraft=replace(world.ground.spacecraft, control=control))
    return world.fly_ground(ground, method=Method.PAPER, config=config)


def rain_db(hours: FloatArray, start_h: float, depth_db: float, slope_db_min: float, full_h: float) -> FloatArray:
    """Return the fade (T,) of a rain that comes and goes with one slope and stays in full for some hours."""
    ramp_h = depth_db / slope_db_min / 60.0
    since_h = np.minimum(hours - start_h, start_h + 2.0 * ramp_h + full_h - hours)
    return np.asarray(np.clip(60.0 * slope_db_min * since_h, 0.0, depth_db))
