"""The chain over worlds of the simulator, array in, rows out: what campaigns of the tests share.

The simulator writes its file and this module reads it, as a study would; the service sees levels and sensor angles,
the truth stays with the judge.
"""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from kept_results import kept

from analyzer_sim.export import export_npz
from analyzer_sim.world.world import World
from service.pipeline.alignment.paper_references import reference_powers
from service.pipeline.calibration.geometry_rows import CalibrationInput
from service.pipeline.calibration.paper_calibration import calibrate_paper
from service.pipeline.chain import Chain
from service.pipeline.config import AlignmentConfig, CalibrationConfig, ChainConfig
from service.pipeline.inputs.sensor_angles import smooth_angles
from service.records.calibration import (
    Alignment,
    Calibration,
    CalibrationMethod,
    CalibrationRequest,
    CalibrationState,
    Window,
)
from service.records.catalogue import (
    Carrier,
    CarrierPlan,
    ControlMode,
    ControlSettings,
    Ephemeris,
    Method,
    Onboard,
    Release,
    Site,
    Spacecraft,
    Station,
)
from service.records.inputs import AlignmentSet, CalibrationActivation, EphemerisChange, PlanChange, SpacecraftChange
from service.records.levels.measurement import Measurement, MeasurementSeries, ReferenceSeries

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


class _Documents:
    """The documents of one world by number; each kind has one."""

    def __init__(self, plan, ephemeris, calibration, alignment):
        self._kept = {"plan": plan, "ephemeris": ephemeris, "calibration": calibration, "alignment": alignment}

    def plan(self, _number):
        return self._kept["plan"]

    def ephemeris(self, _number):
        return self._kept["ephemeris"]

    def calibration(self, _number):
        return self._kept["calibration"]

    def alignment(self, _number):
        return self._kept["alignment"]


class ExportedWorld:
    """One world as its file says it."""

    def __init__(self, scenario, seed: int) -> None:
        with TemporaryDirectory() as folder:
            export_npz(World(scenario, seed), path := Path(folder) / "world.npz")
            with np.load(path) as file:
                self._file = {name: file[name] for name in file.files}
        self.carrier_ids = tuple(str(name) for name in self._file["carrier_id"])
        self.epochs_us = self._file["epoch_us"]
        # powers are kept as float32 by the archive, so that is what the chain gets
        self.power_dbm = self._file["power_dbm"].astype(np.float32).astype(np.float64)
        names = [str(name) for name in self._file["phase_name"]]
        stretches = zip(self._file["phase_start_us"], self._file["phase_stop_us"], strict=True)
        self.phases = {
            name: Window(int(start), int(stop)) for name, (start, stop) in zip(names, stretches, strict=True)
        }
        stations = Station(60.0, 60.0)
        self._plan = CarrierPlan(
            1, "exported", tuple(Carrier(c, "Ku", "T1", 11.2e9, 1e6, station=stations) for c in self.carrier_ids)
        )
        nodes = tuple(int(node) for node in self._file["node_us"])
        first, last = int(self.epochs_us[0]), int(self.epochs_us[-1])
        self._ephemeris = Ephemeris(1, nodes, float(self._file["nodal_period_s"]), first, last, "nodes")

    def series(self, window: Window) -> MeasurementSeries:
        """Return the powers of a window."""
        chosen = (self.epochs_us >= window.start_us) & (self.epochs_us < window.stop_us)
        return MeasurementSeries(self.carrier_ids, self.epochs_us[chosen], self.power_dbm[chosen])

    def references(self, window: Window) -> tuple[ReferenceSeries, ...]:
        """Return the star tracker's angles of a window."""
        epochs_us = self._file["reference_epoch_us"]
        chosen = (epochs_us >= window.start_us) & (epochs_us < window.stop_us)
        angles = np.column_stack([self._file[f"reference_{axis}_deg"] for axis in ("yaw", "roll", "pitch")])[chosen]
        sigma = np.tile(self._file["reference_sigma_deg"], (len(angles), 1))
        return (ReferenceSeries("star_tracker", epochs_us[chosen], angles, sigma),)

    def drive(self, config: ChainConfig) -> Driven:
        """Calibrate, align and run the chain over the operation phase."""
        calibration = self._calibrate()
        chain = Chain(self._documents(calibration), config)
        for content in (
            SpacecraftChange(_spacecraft(), 1),
            PlanChange(1),
            EphemerisChange(1),
            CalibrationActivation(1, 1),
            AlignmentSet(1),
        ):
            chain.update(content)
        in_operation = np.flatnonzero(self.epochs_us >= self.phases["operation"].start_us)
        outcomes = [chain.step(self._measurement(k)) for k in in_operation]
        rows = [row for outcome in outcomes for row in outcome.rows]
        return Driven(
            rows,
            [outcome.command for outcome in outcomes],
            np.column_stack([self._file[f"{axis}_deg"] for axis in ("yaw", "roll", "pitch")])[in_operation],
            np.array([row.attitude_deg for row in rows]),
            self._file["downlink_fade_db"][in_operation],
            np.array(["downlink_fade" in row.inhibitions for row in rows]),
            calibration,
        )

    def _calibrate(self) -> Calibration:
        quiet, turns = self.phases["quiet"], self.phases["turns"]
        request = CalibrationRequest(quiet, turns, CalibrationMethod.PAPER)
        data = CalibrationInput(
            request, self._plan, self._ephemeris, self.series(quiet), self.series(turns), self.references(turns)
        )
        result = calibrate_paper(data, CalibrationConfig())
        return Calibration(1, 1, 1, CalibrationState.ACTIVE, request, 0, "test", result)

    def _documents(self, calibration: Calibration) -> _Documents:
        window = self.phases["alignment"]
        stated, missing = smooth_angles(self.references(window), STAR_TRACKER)
        assert not missing
        powers = reference_powers(self.series(window), stated, calibration, self._ephemeris, AlignmentConfig())
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
        return _Documents(self._plan, self._ephemeris, calibration, alignment)

    def _measurement(self, k: int) -> Measurement:
        epoch_us = int(self.epochs_us[k])
        return Measurement(epoch_us, epoch_us, int(k) + 10, "sa-1", 1, self.power_dbm[k], None)


def driven(scenario, seed: int, config: ChainConfig | None = None) -> Driven:
    """Return what the chain makes of a world; calibrated and flown once for all tests."""
    return kept(_driven, scenario, seed, config or ChainConfig())


def _driven(scenario, seed: int, config: ChainConfig) -> Driven:
    return ExportedWorld(scenario, seed).drive(config)


def _spacecraft() -> Spacecraft:
    return Spacecraft(
        "simulated",
        "Simulated",
        90.0,
        Site(55.0, 37.0),
        ((2600.0, 0.0, 0.0), (0.0, 1400.0, 0.0), (0.0, 0.0, 2600.0)),
        0.05,
        simulated=True,
        onboard=Onboard(fast_loop=True, forecast_mode=True),
        control=ControlSettings(Method.PAPER, ControlMode.GROUND, Release.AUTOMATIC),
    )
