"""A small payload whose every figure is chosen: carriers with known slopes for each sign and known harmonics.

Powers follow the model of the paper method exactly, so that what the chain should answer is known without a
simulator: level + harmonic(node phase) + f(attitude) + whatever a test adds.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from service.core.estimation.paper.snapshot import predict_deviation_db
from service.core.geometry.line_of_sight import node_phase_rad
from service.pipeline.calibration.geometry_rows import CalibrationInput
from service.pipeline.inputs.knowledge import JournalDocuments
from service.records.calibration import (
    Alignment,
    Calibration,
    CalibrationMethod,
    CalibrationRequest,
    CalibrationResult,
    CalibrationState,
    CarrierCalibration,
    CarrierReference,
    Harmonic,
    NoiseComponent,
    Observability,
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
from service.records.inputs import (
    AlignmentSet,
    AttitudeReference,
    CalibrationActivation,
    EphemerisChange,
    PlanChange,
    SpacecraftChange,
)
from service.records.levels.attitude import Axes, FloatArray, IntArray
from service.records.levels.measurement import Measurement, MeasurementSeries, ReferenceSeries

S = 1_000_000
MINUTE = 60 * S
HOUR = 3600 * S
START_US = 1_800_000_000 * S
PERIOD_S = 86_328.0
DAY = round(PERIOD_S * S)
SC = "yamal-test"
INERTIA = ((2600.0, 0.0, 0.0), (0.0, 1400.0, 0.0), (0.0, 0.0, 2600.0))
NAN = float("nan")


def turn_angles() -> FloatArray:
    """Return one attitude a row (K, 3) of calibration turns: twelve rows a level, zeros between the axes."""
    levels = [np.zeros(3)]
    for axis in range(3):
        levels += [size * np.eye(3)[axis] for size in (0.25, 0.5, -0.25, -0.5)] + [np.zeros(3)]
    levels += [np.array([y, r, p]) for y in (0.3, -0.3) for r in (0.3, -0.3) for p in (0.3, -0.3)]
    return np.repeat(np.array(levels), 12, axis=0)


def selected_carrier(
    carrier_id: str, harmonic: Harmonic, plus: FloatArray, minus: FloatArray, noise: tuple[NoiseComponent, ...]
) -> CarrierCalibration:
    """Return the calibration of a carrier that the paper method uses, by its slopes (3,) of each sign in dB/deg."""
    return CarrierCalibration(
        id=carrier_id,
        level_dbm=harmonic.offset_dbm,
        sigma_white_db=0.05,
        noise=noise,
        harmonic=harmonic,
        sensitivity_db_per_deg=Axes(*(0.5 * (plus + minus)).tolist()),
        sensitivity_plus_db_per_deg=Axes(*plus.tolist()),
        sensitivity_minus_db_per_deg=Axes(*minus.tolist()),
        residual_db=0.05,
        stability_residual_rms_db=0.05,
        drift_db_per_day=0.0,
        deviation_at_0p5_deg_db=0.0,
        nonlinearity_deg=0.0,
        linear_range_deg=0.5,
        axis="mixed",
        axis_ratio=1.5,
        criteria_met=("stable", "linear"),
        rejected_because=(),
        selected=True,
    )


@dataclass(frozen=True)
class SyntheticPayload:
    """Truth of some carriers, and makers of everything the service would know of them."""

    ids: tuple[str, ...]
    #: (N, 3) dB/deg
    plus: FloatArray
    minus: FloatArray
    #: (N,) dBm, dB, rad
    level_dbm: FloatArray
    amplitude_db: FloatArray
    phase_rad: FloatArray

    @classmethod
    def make(cls, carriers: int = 12, seed: int = 7) -> "SyntheticPayload":
        """Return carriers that answer to roll and pitch, and eight times less to yaw."""
        rng = np.random.default_rng(seed)
        plus = rng.normal(0.0, [0.2, 1.4, 1.2], (carriers, 3))
        return cls(
            tuple(f"c{k:02d}" for k in range(carriers)),
            plus,
            plus * rng.uniform(0.7, 1.4, (carriers, 3)),
            rng.uniform(-50.0, -40.0, carriers),
            rng.uniform(0.1, 0.4, carriers),
            rng.uniform(-np.pi, np.pi, carriers),
        )

    def permuted(self, order: IntArray) -> "SyntheticPayload":
        """Return the same payload with its carriers in another order."""
        return SyntheticPayload(
            tuple(self.ids[k] for k in order),
            *(getattr(self, name)[order] for name in ("plus", "minus", "level_dbm", "amplitude_db", "phase_rad")),
        )

    def node_phase(self, epochs_us: IntArray) -> FloatArray:
        """Return the phase that the harmonic is counted in."""
        return node_phase_rad(epochs_us, np.array(self.ephemeris().ascending_nodes_us), PERIOD_S)

    def harmonic_db(self, epochs_us: IntArray) -> FloatArray:
        """Return the harmonic, shape (T, N)."""
        return np.asarray(self.amplitude_db * np.cos(self.node_phase(epochs_us)[:, None] + self.phase_rad))

    def power_dbm(
        self, epochs_us: IntArray, angles_deg: FloatArray, *, noise_db: float = 0.0, seed: int = 1
    ) -> FloatArray:
        """Return powers (T, N) at some attitudes (T, 3) or one attitude (3,)."""
        angles = np.broadcast_to(angles_deg, (len(epochs_us), 3))
        noise = noise_db * np.random.default_rng(seed).normal(size=(len(epochs_us), len(self.ids)))
        answer = predict_deviation_db(self.plus, self.minus, angles)
        return np.asarray(self.level_dbm + self.harmonic_db(epochs_us) + answer + noise)

    def carriers(self) -> tuple[Carrier, ...]:
        """Return the catalogue's carriers."""
        return tuple(
            Carrier(name, "Ku", "K1", 11.2e9, 1.25e6, Station(56.0, 38.0), 14.25e9, uplink_power_control="none")
            for name in self.ids
        )

    def plan(self, plan_id: int = 1) -> CarrierPlan:
        """Return the plan of all carriers."""
        return CarrierPlan(plan_id, f"sha-{plan_id}", self.carriers())

    def ephemeris(self) -> Ephemeris:
        """Return ten days of ascending nodes."""
        nodes_us = tuple(START_US - 3 * HOUR + k * DAY for k in range(10))
        return Ephemeris(1, nodes_us, PERIOD_S, START_US, START_US + 10 * DAY, "nodes")

    def spacecraft(self, **control: Any) -> Spacecraft:
        """Return a simulated spacecraft under ground control by the paper method, released by itself."""
        settings = {"method": Method.PAPER, "mode": ControlMode.GROUND, "release": Release.AUTOMATIC, **control}
        return Spacecraft(
            SC,
            "Test",
            90.0,
            Site(55.0, 37.0),
            INERTIA,
            0.05,
            simulated=True,
            onboard=Onboard(fast_loop=True, forecast_mode=True),
            control=ControlSettings(**settings),
        )

    @property
    def request(self) -> CalibrationRequest:
        """Return the request for two quiet days and the turns after them."""
        quiet = Window(START_US, START_US + 2 * DAY + HOUR)
        turns = Window(quiet.stop_us, quiet.stop_us + len(turn_angles()) * MINUTE)
        return CalibrationRequest(quiet, turns, CalibrationMethod.PAPER)

    def references(self, window: Window, angles_deg: FloatArray, source: str = "star_tracker") -> ReferenceSeries:
        """Return one reading a minute over a window."""
        epochs_us = np.arange(window.start_us, window.stop_us, MINUTE)
        angles = np.broadcast_to(angles_deg, (len(epochs_us), 3)).astype(np.float64)
        return ReferenceSeries(source, epochs_us, angles.copy(), np.full((len(epochs_us), 3), 0.01))

    def series(
        self, window: Window, angles_deg: Any = (0.0, 0.0, 0.0), step_s: int = 60, **options: Any
    ) -> MeasurementSeries:
        """Return the rows of a window."""
        epochs_us = np.arange(window.start_us, window.stop_us, step_s * S)
        return MeasurementSeries(self.ids, epochs_us, self.power_dbm(epochs_us, np.asarray(angles_deg), **options))

    def calibration_input(self, noise_db: float = 0.0) -> CalibrationInput:
        """Return what the archive would hold for the request."""
        request, angles = self.request, turn_angles()
        return CalibrationInput(
            request,
            self.plan(),
            self.ephemeris(),
            self.series(request.quiet, step_s=240, noise_db=noise_db, seed=1),
            self.series(request.turns, angles, noise_db=noise_db, seed=2),
            (self.references(request.turns, angles),),
        )

    def calibration(self, calibration_id: int = 1, **changes: Any) -> Calibration:
        """Return a calibration that knows the truth."""
        carriers = tuple(replace(self._carrier(k), **changes) for k in range(len(self.ids)))
        result = CalibrationResult(carriers, Observability(30.0, Axes(5, 0.2, 0.7), Axes(1, 0.04, 0.1)), {}, ())
        return Calibration(calibration_id, 1, 1, CalibrationState.ACTIVE, self.request, START_US, "engineer", result)

    def _carrier(self, k: int) -> CarrierCalibration:
        level, amplitude, phase = float(self.level_dbm[k]), float(self.amplitude_db[k]), float(self.phase_rad[k])
        harmonic = Harmonic(amplitude, phase, level, PERIOD_S, START_US, 0.05, 700, 3)
        noise = (NoiseComponent(1200.0, 0.02),) if k % 2 else ()
        return selected_carrier(self.ids[k], harmonic, self.plus[k], self.minus[k], noise)

    def alignment(self, epoch_us: int, alignment_id: int = 1, calibration_id: int = 1) -> Alignment:
        """Return an alignment at zero attitude whose references are the true levels."""
        references = tuple(
            CarrierReference(name, float(level), 0.02, 15, 0.0)
            for name, level in zip(self.ids, self.level_dbm, strict=True)
        )
        window = Window(epoch_us - 900 * S, epoch_us + 1)
        zero, sigma = Axes(0.0, 0.0, 0.0), Axes(0.01, 0.01, 0.01)
        return Alignment(
            alignment_id, epoch_us, zero, sigma, calibration_id, "star_tracker", epoch_us, "me", references, window
        )

    def measurement(self, epoch_us: int, angles_deg: Any = (0.0, 0.0, 0.0), **changes: Any) -> Measurement:
        """Return one row, received two seconds after its epoch."""
        power = self.power_dbm(np.array([epoch_us]), np.asarray(angles_deg, dtype=np.float64))[0]
        number = 1000 + (epoch_us - START_US) // S
        return replace(Measurement(epoch_us, epoch_us + 2 * S, number, "sa-1", 1, power, None), **changes)


class FixedDocuments(JournalDocuments):
    """Documents by number, as a test lays them down."""

    def __init__(self, payload: SyntheticPayload, aligned_at_us: int) -> None:
        super().__init__(
            {1: payload.plan()},
            {1: payload.ephemeris()},
            {1: payload.calibration()},
            {1: payload.alignment(aligned_at_us)},
        )


def opening(spacecraft: Spacecraft) -> tuple[Any, ...]:
    """Return the slow inputs with which a journal of operation opens."""
    return (
        SpacecraftChange(spacecraft, 1),
        PlanChange(1),
        EphemerisChange(1),
        CalibrationActivation(1, 1),
        AlignmentSet(1),
    )


def reference_records(series: ReferenceSeries) -> list[AttitudeReference]:
    """Return readings as the records that enter the journal."""
    return [
        AttitudeReference(series.source, int(t), Axes(*a.tolist()), Axes(*s.tolist()))
        for t, a, s in zip(series.epochs_us, series.attitude_deg, series.sigma_deg, strict=True)
    ]
