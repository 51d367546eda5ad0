"""A world of the simulator as the windows of a calibration by geometry, and the truth by which it is judged.

The service sees what a station would have sent: powers as the archive keeps them, sensor angles, the catalogue and the
track. The truth, levels without noise and beams, stays with the judge.
"""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from kept_results import kept
from simulated_gain import attitude_gain_db

from analyzer_sim.export import export_arrays
from analyzer_sim.streams import daily_wave, stream
from analyzer_sim.world.payload.level_terms import dishes_loss_db, nominal_gain_db
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World
from service.core.estimation.calibration.geometry_columns import predict_deviation
from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.calibration.geometry_rows import CalibrationInput
from service.pipeline.carrier_model.expected_level import ExpectedLevel, geometry_model
from service.pipeline.config import CalibrationConfig
from service.records.calibration import CalibrationResult
from service.records.catalogue import CarrierPlan
from service.study.estimation.flight import drive
from service.study.estimation.flight.world import Ground, world_of

DAY_US = 86_400_000_000
_DIFFERENCE_DEG = 0.02


@dataclass(frozen=True)
class CalibratedWorld:
    """One world, its calibration, and what the calibration took."""

    world: World
    arrays: dict[str, Any]
    data: CalibrationInput
    result: CalibrationResult
    spent_s: float

    @classmethod
    def of(cls, name: str, seed: int, operation_days: float = 7.0, **options: Any) -> "CalibratedWorld":
        """Calibrate on the quiet days and the turns of a scenario."""
        world = World(scenario_named(name, operation_days=operation_days, **options), seed)
        arrays = export_arrays(world)
        data = calibration_input(_ground(arrays))
        begin = time.process_time()
        result = calibrate_geometry(data, CalibrationConfig())
        return cls(world, arrays, data, result, time.process_time() - begin)

    def level_error_db(self, day: int) -> np.ndarray:
        """Return predicted less true levels (T, N) over a day of operation, what all carriers share taken out."""
        start_us = self.world.scenario.operation_start_us + (day - 1) * DAY_US
        epochs_us = self.arrays["epoch_us"]
        epochs_us = epochs_us[(epochs_us >= start_us) & (epochs_us < start_us + DAY_US)][::10]
        fit = self.result.geometry
        expected = ExpectedLevel(geometry_model(fit), fit, self.data.ephemeris)
        error = np.array([expected(int(at)) for at in epochs_us]) - self._true_level_dbm(epochs_us)
        return error - error.mean(axis=1, keepdims=True)

    def deviation_error_db(self, attitude_deg: np.ndarray) -> np.ndarray:
        """Return predicted less true deviations (K, N) at some attitudes."""
        model = geometry_model(self.result.geometry)
        return predict_deviation(attitude_deg, model.response) - (self._gain_db(attitude_deg) - self._gain_db())

    def slope_errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Return errors of the slopes (N, 3) in dB/deg and the same over their own sigmas."""
        response = geometry_model(self.result.geometry).response
        steps = _DIFFERENCE_DEG * np.eye(3)
        truth = (self._gain_db(steps) - self._gain_db(-steps)).T / (2.0 * _DIFFERENCE_DEG)
        sigma = np.sqrt(np.diagonal(response.covariance, axis1=1, axis2=2))[:, :3]
        return response.slope - truth, (response.slope - truth) / sigma

    def _gain_db(self, attitude_deg: np.ndarray | None = None) -> np.ndarray:
        angles = np.zeros((1, 3)) if attitude_deg is None else attitude_deg
        return nominal_gain_db(self.world.plan, self.world.orbit, angles)

    def _true_level_dbm(self, epochs_us: np.ndarray) -> np.ndarray:
        """Return the levels (T, N) of a body held to the nadir frame: beams, dishes and the solar day."""
        world = self.world
        still = attitude_gain_db(world.plan, world.orbit, epochs_us, np.zeros((len(epochs_us), 3)))
        seconds = (epochs_us - self.arrays["epoch_us"][0]) / 1e6
        size_db = world.scenario.noise.thermal_db
        warm = [daily_wave(stream(world.seed, "thermal", c.id), seconds, size_db) for c in world.plan.carriers]
        dish = dishes_loss_db(world.plan, world.orbit, epochs_us, world.seed)
        return np.array([c.level_dbm for c in world.plan.carriers]) + still - dish + np.stack(warm, axis=1)


def calibrated_world(name: str, seed: int) -> CalibratedWorld:
    """Return a calibrated world with a week of operation; calibrated once for all tests."""
    return kept(CalibratedWorld.of, name, seed)


def ground_of(world: World) -> Ground:
    """Return the ground's half of a world, as its file has it."""
    return _ground(export_arrays(world))


def _ground(arrays: dict[str, Any]) -> Ground:
    return world_of({name: np.asarray(values) for name, values in arrays.items()}).ground


def calibration_input(ground: Ground) -> CalibrationInput:
    """Return what the archive would hold of a world's quiet days and turns."""
    return drive.calibration_input(ground, CarrierPlan(1, "exported", ground.carriers), ground.ephemeris)
