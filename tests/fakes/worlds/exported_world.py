"""The chain over worlds of the simulator, array in, rows out: what campaigns of the tests share.

The simulator writes its file and this module reads it, as a study would; the service sees levels and sensor angles,
the truth stays with the judge.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from kept_results import kept
from synthetic_payload import opening

from analyzer_sim.export import export_npz
from analyzer_sim.world.world import World
from service.pipeline.alignment.paper_references import reference_powers
from service.pipeline.calibration.geometry_rows import CalibrationInput
from service.pipeline.calibration.paper_calibration import calibrate_paper
from service.pipeline.chain import Chain
from service.pipeline.config import AlignmentConfig, CalibrationConfig, ChainConfig
from service.pipeline.inputs.knowledge import JournalDocuments
from service.pipeline.inputs.sensor_angles import smooth_angles
from service.records.calibration import (
    Alignment,
    Calibration,
    CalibrationMethod,
    CalibrationRequest,
    CalibrationState,
    Window,
)
from service.records.catalogue import CarrierPlan, ControlMode, ControlSettings, Method, Release
from service.records.levels.measurement import Measurement, MeasurementSeries
from service.study.estimation.flight.world import read_world

STAR_TRACKER = ("star_tracker",) * 3


@dataclass(frozen=True)
class Driven:
    """What the chain made of the operation phase of one world."""

    rows: list
    commands: list
    #: (T, 3) deg, yaw, roll, pitch
    truth_deg: np.ndarray
    #: (T, 3) deg, NaN = none
    estimate_deg: np.ndarray
    #: (T,) dB
    downlink_fade_db: np.ndarray
    #: (T,) whether the fade rule held control
    is_stopped: np.ndarray
    calibration: Calibration


class ExportedWorld:
    """One world as its file says it."""

    def __init__(self, scenario, seed: int) -> None:
        with TemporaryDirectory() as folder:
            export_npz(World(scenario, seed), path := Path(folder) / "world.npz")
            self.ground, self.truth = (found := read_world(path)).ground, found.truth
        self._plan = CarrierPlan(1, "exported", self.ground.carriers)

    def series(self, window: Window) -> MeasurementSeries:
        """Return the powers of a window."""
        return self.ground.series(window, self.ground.carrier_ids)

    def drive(self, config: ChainConfig) -> Driven:
        """Calibrate, align and run the chain over the operation phase."""
        calibration = self._calibrate()
        chain = Chain(self._documents(calibration), config)
        settings = ControlSettings(Method.PAPER, ControlMode.GROUND, Release.AUTOMATIC)
        for content in opening(replace(self.ground.spacecraft, control=settings)):
            chain.update(content)
        in_operation = np.flatnonzero(self.ground.epochs_us >= self.ground.phases["operation"].start_us)
        outcomes = [chain.step(self._measurement(k)) for k in in_operation]
        rows = [row for outcome in outcomes for row in outcome.rows]
        return Driven(
            rows,
            [outcome.command for outcome in outcomes],
            self.truth.attitude_deg[in_operation],
            np.array([row.attitude_deg for row in rows]),
            self.truth.downlink_fade_db[in_operation],
            np.array(["downlink_fade" in row.inhibitions for row in rows]),
            calibration,
        )

    def _calibrate(self) -> Calibration:
        quiet, turns = self.ground.phases["quiet"], self.ground.phases["turns"]
        request = CalibrationRequest(quiet, turns, CalibrationMethod.PAPER)
        data = CalibrationInput(
            request,
            self._plan,
            self.ground.ephemeris,
            self.series(quiet),
            self.series(turns),
            self.ground.references_in(turns),
        )
        result = calibrate_paper(data, CalibrationConfig())
        return Calibration(1, 1, 1, CalibrationState.ACTIVE, request, 0, "test", result)

    def _documents(self, calibration: Calibration) -> JournalDocuments:
        window = self.ground.phases["alignment"]
        stated, missing = smooth_angles(self.ground.references_in(window), STAR_TRACKER)
        assert not missing
        powers = reference_powers(self.series(window), stated, calibration, self.ground.ephemeris, AlignmentConfig())
        alignment = Alignment(
            1,
            stated.epoch_us,
            stated.attitude_deg,
            stated.sigma_deg,
            1,
            "star_tracker",
            0,
            "test",
            powers.references,
            window=window,
        )
        return JournalDocuments({1: self._plan}, {1: self.ground.ephemeris}, {1: calibration}, {1: alignment})

    def _measurement(self, k: int) -> Measurement:
        epoch_us = int(self.ground.epochs_us[k])
        return Measurement(epoch_us, epoch_us, int(k) + 10, "sa-1", 1, self.ground.power_dbm[k], None)


def driven(scenario, seed: int, config: ChainConfig | None = None) -> Driven:
    """Return what the chain makes of a world; calibrated and flown once for all tests."""
    return kept(_driven, scenario, seed, config or ChainConfig())


def _driven(scenario, seed: int, config: ChainConfig) -> Driven:
    return ExportedWorld(scenario, seed).drive(config)
