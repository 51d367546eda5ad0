"""A world of the simulator as the windows of a calibration by geometry, and the truth by which it is judged.

The service sees what a station would have sent: powers as the archive keeps them, sensor angles, the catalogue and the
track. The truth, levels without noise and beams, stays with the judge.
"""

import json
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from kept_results import kept
from simulated_gain import attitude_gain_db

from analyzer_sim.export import export_arrays
from analyzer_sim.streams import stream
from analyzer_sim.world.noise import daily_wave
from analyzer_sim.world.payload.level_terms import dishes_loss_db, nominal_gain_db
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World
from service.core.estimation.calibration.geometry_columns import predict_deviation
from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.calibration.geometry_rows import CalibrationInput
from service.pipeline.carrier_model.expected_level import ExpectedLevel, geometry_model
from service.pipeline.config import CalibrationConfig
from service.records.calibration import CalibrationMethod, CalibrationRequest, CalibrationResult, Window
from service.records.catalogue import CarrierPlan
from service.records.levels.measurement import MeasurementSeries, ReferenceSeries
from service.study.estimation.flight.world import read_carriers, read_ephemeris, read_spacecraft

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
        data = calibration_input(arrays)
        begin = time.process_time()
        result = calibrate_geometry(data, CalibrationConfig())
        return cls(world, arrays, data, result, time.process_time() - begin)

    def level_error_db(self, day: int) -> np.ndarray:
        """Return predicted less true levels (T, N) over a day of operation, what all carriers share taken out."""
        start_us = self.world.scenario.operation_start_us + (day - 1) * DAY_US
        epochs_us = self.arrays["epoch_us"]
        epochs_us = epochs_us[(epochs_us >= start_us) & (epochs_us < start_us + DAY_US)][::10]
        fit = self.result.geometry
        expected = ExpectedLevel(geometry_model(fit, self.result.carriers), fit, self.data.ephemeris)
        error = np.array([expected(int(at)) for at in epochs_us]) - self._true_level_dbm(epochs_us)
        return error - error.mean(axis=1, keepdims=True)

    def deviation_error_db(self, attitude_deg: np.ndarray) -> np.ndarray:
        """Return predicted less true deviations (K, N) at some attitudes."""
        model = geometry_model(self.result.geometry, self.result.carriers)
        return predict_deviation(attitude_deg, model.response) - (self._gain_db(attitude_deg) - self._gain_db())

    def slope_errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Return errors of the slopes (N, 3) in dB/deg and the same over their own sigmas."""
        response = geometry_model(self.result.geometry, self.result.carriers).response
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


def calibration_input(arrays: dict[str, Any]) -> CalibrationInput:
    """Return what the archive would hold of an exported world's quiet days and turns."""
    reported = {line["kind"]: line["body"] for line in json.loads(arrays["catalogue_json"]) if "body" in line}
    names = [str(name) for name in arrays["phase_name"]]
    stretches = zip(arrays["phase_start_us"], arrays["phase_stop_us"], strict=True)
    phases = {name: Window(int(start), int(stop)) for name, (start, stop) in zip(names, stretches, strict=True)}
    quiet, turns = phases["quiet"], phases["turns"]
    return CalibrationInput(
        CalibrationRequest(quiet, turns, CalibrationMethod.GEOMETRY),
        CarrierPlan(1, "exported", read_carriers(reported["carriers"])),
        read_ephemeris(reported["ephemeris"]),
        _series(arrays, quiet),
        _series(arrays, turns),
        _references(arrays, turns),
        _references(arrays, quiet),
        read_spacecraft(reported["spacecraft"]),
    )


def _series(arrays: dict[str, Any], window: Window) -> MeasurementSeries:
    chosen = (arrays["epoch_us"] >= window.start_us) & (arrays["epoch_us"] < window.stop_us)
    power = arrays["power_dbm"].astype(np.float32).astype(np.float64)[chosen]
    return MeasurementSeries(tuple(str(name) for name in arrays["carrier_id"]), arrays["epoch_us"][chosen], power)


def _references(arrays: dict[str, Any], window: Window) -> tuple[ReferenceSeries, ...]:
    at_us = arrays["reference_epoch_us"]
    chosen = (at_us >= window.start_us) & (at_us < window.stop_us)
    angles = np.column_stack([arrays[f"reference_{axis}_deg"] for axis in ("yaw", "roll", "pitch")])[chosen]
    sigma = np.tile(arrays["reference_sigma_deg"], (len(angles), 1))
    return (ReferenceSeries("star_tracker", at_us[chosen], angles, sigma),)
