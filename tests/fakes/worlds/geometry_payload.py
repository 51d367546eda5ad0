"""Calibration windows of a payload that follows the model of the geometry exactly, so that every coefficient is known.

Sixteen stations over the ground that a satellite at 90 E sees, dishes that lose it by the dish law, shaped beams of
gradient and Hessian, a downlink gradient, learned-noise carriers. Readings of the sensors and powers come as the
archive would hand them over; what a test wants wrong it changes in the input.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from service.core.estimation.calibration.geometry_columns import beam_columns, daily_columns
from service.pipeline.calibration.geometry_rows import CalibrationInput, orbit_motion, plan_positions
from service.records.calibration import CalibrationMethod, CalibrationRequest, Window
from service.records.catalogue import Carrier, CarrierPlan, Ephemeris, Site, Spacecraft, Station, Track
from service.records.levels.measurement import MeasurementSeries, ReferenceSeries

S = 1_000_000
MINUTE, HOUR, DAY = 60 * S, 3600 * S, 86_400 * S
#: a midnight UTC
START_US = 20_800 * DAY
PERIOD_S = 86_200.0
NAN = float("nan")


def turned_angles() -> np.ndarray:
    """Return the attitude (K, 3) of the turns, one row a minute: fifteen a level, ten at zero between the axes."""
    levels = []
    for axis in range(3):
        for size in (0.25, 0.5, -0.25, -0.5):
            levels += [(np.eye(3)[axis] * size, 15), (np.zeros(3), 5)]
    for yaw in (0.3, -0.3):
        for roll in (0.3, -0.3):
            for pitch in (0.3, -0.3):
                levels += [(np.array([yaw, roll, pitch]), 15), (np.zeros(3), 5)]
    return np.concatenate([np.tile(angles, (rows, 1)) for angles, rows in levels])


@dataclass(frozen=True)
class GeometryPayload:
    """Truth of some carriers."""

    carriers: tuple[Carrier, ...]
    #: (N, ...) dBm; dB/deg, dB/deg, dB/deg^2; dB/deg and dB/deg^2; (R, 2) dB/deg
    level_dbm: np.ndarray
    daily: np.ndarray
    beam: np.ndarray
    downlink: np.ndarray
    quiet_days: float
    seed: int

    @classmethod
    def make(cls, carriers: int = 16, seed: int = 5, quiet_days: float = 3.0, **changes: Any) -> "GeometryPayload":
        """Return a payload; ``changes`` reach every carrier of the catalogue."""
        rng = np.random.default_rng(seed)
        plain = [
            Carrier(
                f"c{k:02d}",
                "Ku",
                f"K{1 + k // 4}",
                11.2e9 + 2e6 * k,
                1e6,
                Station(float(rng.uniform(45.0, 62.0)), float(rng.uniform(40.0, 135.0))),
                14.2e9 + 2e6 * k,
                uplink_power_control="none",
                transponder_mode="fixed_gain",
            )
            for k in range(carriers)
        ]
        daily = np.column_stack([rng.normal(0.0, 5.0, (carriers, 2)), rng.uniform(10.0, 110.0, carriers)])
        turn = rng.uniform(0.0, 2.0 * np.pi, carriers)
        size = rng.uniform(1.0, 2.2, carriers)
        gradient = np.column_stack([size * np.cos(turn), size * np.sin(turn)])
        beam = np.column_stack([gradient, rng.normal([-1.5, 0.0, -2.7], 0.3, (carriers, 3))])
        return cls(
            tuple(replace(carrier, **changes) for carrier in plain),
            rng.uniform(-45.0, -40.0, carriers),
            daily,
            beam,
            rng.normal(0.0, 0.5, (1, 2)),
            quiet_days,
            seed,
        )

    @property
    def spacecraft(self) -> Spacecraft:
        """Return the satellite and its receiving site."""
        inertia = ((2600.0, 0.0, 0.0), (0.0, 1400.0, 0.0), (0.0, 0.0, 2600.0))
        return Spacecraft("yamal-test", "Test", 90.0, Site(55.9, 38.0, height_m=160.0), inertia, 0.05)

    @property
    def request(self) -> CalibrationRequest:
        """Return quiet days and the turns after them."""
        quiet = Window(START_US, START_US + round(self.quiet_days * DAY))
        turns = Window(quiet.stop_us, quiet.stop_us + len(turned_angles()) * MINUTE)
        return CalibrationRequest(quiet, turns, CalibrationMethod.GEOMETRY)

    def ephemeris(self, *, is_tracked: bool = True) -> Ephemeris:
        """Return an orbit of 0.045 deg inclination whose node is not at midnight, half-hourly over twelve days."""
        at_us = np.arange(START_US - DAY, START_US + 11 * DAY, 30 * MINUTE)
        phase = 2.0 * np.pi * (at_us - START_US - 5 * HOUR) / (PERIOD_S * S)
        track = Track(
            tuple(at_us.tolist()),
            tuple((0.045 * np.sin(phase)).tolist()),
            tuple((90.0 + 0.025 * np.sin(phase + 1.1)).tolist()),
        )
        nodes_us = tuple(START_US + 5 * HOUR + round(k * PERIOD_S * S) for k in range(-1, 10))
        first_us, last_us = track.epochs_us[0], track.epochs_us[-1]
        return Ephemeris(1, nodes_us, PERIOD_S, first_us, last_us, "track", track if is_tracked else None)

    def angles(self, window: Window, turned: np.ndarray | None = None) -> np.ndarray:
        """Return the true attitude (T, 3) of a window: a slow motion, and the turns."""
        minutes = np.arange(window.start_us, window.stop_us, MINUTE) / MINUTE
        waves = 2.0 * np.pi * minutes[:, None] / np.array([900.0, 1100.0, 700.0]) + np.array([0.0, 1.0, 2.0])
        slow = np.array([0.06, 0.04, 0.04]) * np.sin(waves)
        return slow if turned is None else slow + turned

    def power_dbm(self, epochs_us: np.ndarray, angles_deg: np.ndarray) -> np.ndarray:
        """Return powers (T, N) without noise."""
        known = self.data(noise_db=None)
        positions = plan_positions(CarrierPlan(1, "x", self.carriers), self.spacecraft)
        motion = orbit_motion(known, epochs_us, positions)
        own, shared = beam_columns(angles_deg, positions.geometry, motion)
        daily = daily_columns(motion, np.zeros(len(epochs_us)), len(self.carriers))
        is_beacon = positions.is_beacon[:, None]
        dish, beam = np.where(is_beacon, 0.0, self.daily), np.where(is_beacon, 0.0, self.beam)
        return (
            self.level_dbm
            + (daily * dish).sum(-1)
            + (own * beam).sum(-1)
            + shared @ np.tile(self.downlink, (len(positions.bands), 1)).ravel()
        )

    def data(
        self, noise_db: float | None = 0.05, sensor_deg: float = 0.005, turned: np.ndarray | None = None
    ) -> CalibrationInput:
        """Return what the archive would hold; ``noise_db`` None leaves the powers out."""
        rng = np.random.default_rng(self.seed + 100)
        request = self.request
        turned = turned_angles() if turned is None else turned
        windows = ((request.quiet, self.angles(request.quiet)), (request.turns, self.angles(request.turns, turned)))
        series, references = [], []
        for window, angles in windows:
            epochs_us = np.arange(window.start_us, window.stop_us, MINUTE)
            power = np.full((len(epochs_us), len(self.carriers)), NAN)
            if noise_db is not None:
                power = self.power_dbm(epochs_us, angles) + noise_db * rng.normal(size=power.shape)
            series.append(MeasurementSeries(tuple(c.id for c in self.carriers), epochs_us, power))
            reported = angles + sensor_deg * rng.normal(size=angles.shape)
            references.append(ReferenceSeries("star_tracker", epochs_us, reported, np.full(reported.shape, sensor_deg)))
        return CalibrationInput(
            request,
            CarrierPlan(1, "geometry", self.carriers),
            self.ephemeris(),
            series[0],
            series[1],
            (references[1],),
            (references[0],),
            self.spacecraft,
        )

    def slopes(self) -> np.ndarray:
        """Return the true slopes (N, 3) at zero attitude, dB/deg."""
        positions = plan_positions(CarrierPlan(1, "x", self.carriers), self.spacecraft)
        matrix = positions.geometry.displacement()
        own = np.einsum("nij,ni->nj", matrix[:-1], np.where(positions.is_beacon[:, None], 0.0, self.beam[:, :2]))
        return own + np.einsum("nij,i->nj", matrix[-1] - matrix[:-1], self.downlink[0])
