"""A small payload of real places: bent beams, dishes, one downlink a band, and all that the service would know of it.

Powers come from geometry that is written once more in ``flight_geometry``.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from flight_geometry import (
    BANDS,
    CITIES,
    HOUR,
    INERTIA,
    LONGITUDE_DEG,
    NODE_US,
    PERIOD_S,
    SC,
    SITE,
    START_US,
    TRANSPONDERS,
    S,
    antenna_deg,
    body_axes,
    orbit_deg,
    positions_m,
    satellite_m,
    turn_rad,
)
from synthetic_payload import selected_carrier

from service.records.calibration import (
    Alignment,
    Calibration,
    CalibrationMethod,
    CalibrationRequest,
    CalibrationResult,
    CalibrationState,
    CarrierCalibration,
    CarrierReference,
    GeometryFit,
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
    Spacecraft,
    Station,
    Track,
)
from service.records.levels.attitude import Axes, FloatArray, IntArray
from service.records.levels.measurement import Measurement, MeasurementSeries


def _table(values: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in values.tolist())


@dataclass(frozen=True)
class FlightPayload:
    """Truth of some carriers, and makers of everything the service would know of them."""

    ids: tuple[str, ...]
    cities: tuple[str, ...]
    transponders: tuple[str, ...]
    #: (N,) dBm; (N, 2) dB/deg; (N, 3) dB/deg^2 az az, az el, el el
    level_dbm: FloatArray
    gradient: FloatArray
    hessian: FloatArray
    #: (N, 3) b1, b2 in dB/deg, k in dB/deg^2; or, without a track, (N, 4) of two harmonics in dB
    daily: FloatArray
    #: (2, 2) dB/deg of C and Ku
    downlink: FloatArray
    #: (N, 2) dB
    solar_db: FloatArray

    @classmethod
    def make(cls, carriers: int = 16, seed: int = 11, *, has_track: bool = True) -> "FlightPayload":
        """Return carriers all over the land, every fourth through the transponder of band C."""
        rng = np.random.default_rng(seed)
        names = tuple(CITIES)
        dish = np.column_stack([rng.normal(0.0, 3.0, (carriers, 2)), rng.uniform(5.0, 40.0, carriers)])
        return cls(
            tuple(f"c{k:02d}" for k in range(carriers)),
            tuple(names[k % len(names)] for k in range(carriers)),
            tuple(TRANSPONDERS[k % 4] for k in range(carriers)),
            rng.uniform(-50.0, -40.0, carriers),
            rng.normal(0.0, [1.3, 1.5], (carriers, 2)),
            rng.normal(0.0, 0.3, (carriers, 3)) + np.array([-1.5, 0.0, -2.7]),
            dish if has_track else rng.normal(0.0, 0.15, (carriers, 4)),
            rng.normal(0.0, 0.2, (2, 2)),
            rng.normal(0.0, 0.03, (carriers, 2)),
        )

    @property
    def has_track(self) -> bool:
        """Whether the daily change is the dish law."""
        return bool(self.daily.shape[1] == 3)

    def permuted(self, order: Any) -> "FlightPayload":
        """Return the payload of some carriers, in another order."""
        taken = np.asarray(order)
        arrays = ("level_dbm", "gradient", "hessian", "daily", "solar_db")
        words = {name: tuple(getattr(self, name)[k] for k in taken) for name in ("ids", "cities", "transponders")}
        changes: dict[str, Any] = {**words, **{name: getattr(self, name)[taken] for name in arrays}}
        return replace(self, **changes)

    # ---- truth

    def band(self) -> IntArray:
        """Return the number (N,) of each carrier's band."""
        return np.array([0 if name.startswith("C") else 1 for name in self.transponders], dtype=np.int64)

    def stations_deg(self) -> FloatArray:
        """Return latitude and longitude (N, 2)."""
        return np.array([CITIES[name] for name in self.cities])

    @cached_property
    def positions_m(self) -> FloatArray:
        """Stations and, last, the receiving site (N + 1, 3)."""
        latitude, longitude = np.vstack([self.stations_deg(), [SITE.latitude_deg, SITE.longitude_deg]]).T
        return positions_m(latitude, longitude)

    @cached_property
    def nominal_deg(self) -> FloatArray:
        """Azimuth and elevation (N + 1, 2) of the places from the nominal longitude."""
        here_m = satellite_m(np.array([[0.0, LONGITUDE_DEG]]))
        still = np.zeros((1, 3))
        return np.asarray(antenna_deg(here_m, body_axes(here_m, still, still), self.positions_m)[0])

    def daily_db(self, epochs_us: Any) -> FloatArray:
        """Return what dish and solar day add (T, N)."""
        epochs = np.asarray(epochs_us, dtype=np.float64)
        day = 2.0 * np.pi * np.mod(epochs / S, 86_400.0) / 86_400.0
        solar = np.column_stack([np.cos(day), np.sin(day)]) @ self.solar_db.T
        if not self.has_track:
            turn = turn_rad(epochs)
            waves = np.column_stack([np.cos(turn), np.sin(turn), np.cos(2 * turn), np.sin(2 * turn)])
            return np.asarray(solar + waves @ self.daily.T)
        motion = self._sight_deg(epochs)
        dish = (motion * self.daily[:, :2]).sum(axis=-1) - self.daily[:, 2] * (motion**2).sum(axis=-1)
        return np.asarray(solar + dish)

    def _sight_deg(self, epochs_us: FloatArray) -> FloatArray:
        """Return where the satellite stands beside the axis of each dish (T, N, 2), East and up."""
        positions = self.positions_m[:-1]
        axis = satellite_m(np.array([0.0, LONGITUDE_DEG])) - positions
        axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
        east = np.stack([-axis[:, 1], axis[:, 0], np.zeros(len(axis))], axis=-1)
        east = east / np.linalg.norm(east, axis=-1, keepdims=True)
        sight = satellite_m(orbit_deg(epochs_us))[:, None] - positions
        ahead = np.einsum("tnj,nj->tn", sight, axis)
        sides = (east, np.cross(axis, east))
        angles = [np.arctan(np.einsum("tnj,nj->tn", sight, side) / ahead) for side in sides]
        return np.asarray(np.degrees(np.stack(angles, axis=-1)))

    def power_dbm(self, epochs_us: Any, angles_deg: Any) -> FloatArray:
        """Return powers (T, N) at some attitudes (T, 3) or one attitude (3,)."""
        epochs = np.asarray(epochs_us, dtype=np.float64)
        angles = np.broadcast_to(np.asarray(angles_deg, dtype=np.float64), (len(epochs), 3))
        if self.has_track:
            here_m = satellite_m(orbit_deg(epochs))
            moved_m = satellite_m(orbit_deg(epochs + S)) - satellite_m(orbit_deg(epochs - S))
            axes = body_axes(here_m, moved_m / 2.0, angles)
        else:
            here_m = np.tile(satellite_m(np.array([[0.0, LONGITUDE_DEG]])), (len(epochs), 1))
            axes = body_axes(here_m, np.zeros((1, 3)), angles)
        moved = antenna_deg(here_m, axes, self.positions_m) - self.nominal_deg
        d, site, bend = moved[:, :-1], moved[:, -1:], self.hessian
        beam = (
            (d * self.gradient).sum(axis=-1)
            + 0.5 * bend[:, 0] * d[..., 0] ** 2
            + bend[:, 1] * d[..., 0] * d[..., 1]
            + 0.5 * bend[:, 2] * d[..., 1] ** 2
        )
        shared = ((site - d) * self.downlink[self.band()]).sum(axis=-1)
        return np.asarray(self.level_dbm + self.daily_db(epochs_us) + beam + shared)

    # ---- catalogue

    def carriers(self) -> tuple[Carrier, ...]:
        """Return the catalogue's carriers."""
        return tuple(
            Carrier(
                name,
                "C" if transponder.startswith("C") else "Ku",
                transponder,
                11.2e9,
                1.25e6,
                Station(*CITIES[city], city),
                14.25e9,
                uplink_power_control="none",
            )
            for name, city, transponder in zip(self.ids, self.cities, self.transponders, strict=True)
        )

    def plan(self, plan_id: int = 1) -> CarrierPlan:
        """Return the plan of all carriers."""
        return CarrierPlan(plan_id, f"sha-{plan_id}", self.carriers())

    def ephemeris(
        self, ephemeris_id: int = 1, start_us: int = START_US - 86_400 * S, stop_us: int = START_US + 345_600 * S
    ) -> Ephemeris:
        """Return nodes of ten days, and a track between two epochs where the dish law needs one."""
        epochs_us = np.arange(start_us, stop_us + 1, 600 * S)
        latitude, longitude = orbit_deg(epochs_us).T
        track = Track(tuple(epochs_us.tolist()), tuple(latitude.tolist()), tuple(longitude.tolist()))
        nodes_us = tuple(NODE_US + k * round(PERIOD_S * S) for k in range(10))
        known = track if self.has_track else None
        return Ephemeris(ephemeris_id, nodes_us, PERIOD_S, start_us, stop_us, "nodes", known)

    def spacecraft(self, *, coupling: bool | None = False, **control: Any) -> Spacecraft:
        """Return a simulated spacecraft under ground control by the robust method, released in two steps."""
        settings = {"method": Method.ROBUST, "mode": ControlMode.GROUND, "release": Release.TWO_STEP, **control}
        return Spacecraft(
            SC,
            "Test",
            LONGITUDE_DEG,
            SITE,
            INERTIA,
            0.05,
            simulated=True,
            onboard=Onboard(fast_loop=True, forecast_mode=True, roll_yaw_coupling=coupling),
            control=ControlSettings(**settings),
        )

    # ---- calibration and alignment that know the truth

    @property
    def request(self) -> CalibrationRequest:
        """Return the request for the two days before the start."""
        quiet = Window(START_US - 48 * HOUR, START_US - 10 * HOUR)
        return CalibrationRequest(quiet, Window(quiet.stop_us, START_US), CalibrationMethod.GEOMETRY)

    def geometry(self, **changes: Any) -> GeometryFit:
        """Return the truth as the record of a fit, errors of 0.02 dB in the levels."""
        count, size = len(self.ids), 1 + self.daily.shape[1] + 5
        nominal, stations = self.nominal_deg, self.stations_deg()
        spread = np.diag([0.02**2] + [1e-10] * (size - 1))
        labels = tuple(sorted(set(self.transponders)))
        fit = GeometryFit(
            is_dish_law=self.has_track,
            bands=BANDS,
            band=tuple(self.band().tolist()),
            rain_share=(0.1, 1.0),
            transponders=labels,
            transponder=tuple(labels.index(name) for name in self.transponders),
            station_azimuth_deg=tuple(nominal[:-1, 0].tolist()),
            station_elevation_deg=tuple(nominal[:-1, 1].tolist()),
            station_latitude_deg=tuple(stations[:, 0].tolist()),
            station_longitude_deg=tuple(stations[:, 1].tolist()),
            site_deg=(float(nominal[-1, 0]), float(nominal[-1, 1])),
            site_position=(SITE.latitude_deg, SITE.longitude_deg, 0.0),
            nominal_longitude_deg=LONGITUDE_DEG,
            level_dbm=tuple(self.level_dbm.tolist()),
            daily=_table(self.daily),
            gradient=_table(self.gradient),
            hessian=_table(self.hessian),
            downlink=_table(self.downlink),
            covariance=(_table(spread),) * count,
            downlink_covariance=_table(1e-10 * np.eye(4)),
            downlink_gain=(((0.0,) * 4,) * size,) * count,
            solar_day_db=_table(self.solar_db),
            quantisation_db=(0.0,) * count,
            reference_walk_db=(0.006,) * count,
            common_noise=(),
            is_used=(True,) * count,
        )
        return replace(fit, **changes)

    def calibration(self, calibration_id: int = 1, plan_id: int = 1, **changes: Any) -> Calibration:
        """Return a calibration by geometry with the paper part that goes with it."""
        observed = Observability(30.0, Axes(5, 0.2, 0.7), Axes(1, 0.04, 0.1))
        result = CalibrationResult(self._carriers, observed, {}, (), self.geometry(**changes))
        state = CalibrationState.ACTIVE
        return Calibration(calibration_id, plan_id, 1, state, self.request, START_US, "engineer", result)

    @cached_property
    def _carriers(self) -> tuple[CarrierCalibration, ...]:
        return tuple(self._carrier(k) for k in range(len(self.ids)))

    @cached_property
    def _harmonics(self) -> tuple[Harmonic, ...]:
        return tuple(self.permuted([k]).harmonic() for k in range(len(self.ids)))

    def _carrier(self, k: int) -> CarrierCalibration:
        own = self.permuted([k])
        level = float(own.power_dbm([START_US], np.zeros(3))[0, 0])
        turned = own.power_dbm([START_US] * 6, 0.3 * np.vstack([np.eye(3), -np.eye(3)]))[:, 0]
        plus, minus = (turned[:3] - level) / 0.3, (level - turned[3:]) / 0.3
        noise = (NoiseComponent(1200.0, 0.02), NoiseComponent(7200.0, 0.01))
        return selected_carrier(self.ids[k], self._harmonics[k], plus, minus, noise)

    def harmonic(self) -> Harmonic:
        """Return the one wave that comes nearest to the first carrier's day."""
        epochs_us = START_US + np.arange(96) * round(PERIOD_S * S / 96)
        turn = turn_rad(epochs_us)
        power = self.power_dbm(epochs_us, np.zeros(3))[:, 0]
        waves = np.column_stack([np.ones(96), np.cos(turn), np.sin(turn)])
        found = np.linalg.lstsq(waves, power, rcond=None)[0]
        offset, cosine, sine = found.tolist()
        rms = float((power - waves @ found).std())
        return Harmonic(
            float(np.hypot(cosine, sine)), float(np.arctan2(-sine, cosine)), offset, PERIOD_S, NODE_US, rms, 96, 0
        )

    def alignment(
        self,
        epoch_us: int,
        alignment_id: int = 1,
        calibration_id: int = 1,
        angles_deg: Any = (0.0, 0.0, 0.0),
        **changes: Any,
    ) -> Alignment:
        """Return an alignment whose references are the true levels of either method."""
        offsets = np.array([harmonic.offset_dbm for harmonic in self._harmonics])
        reported = {"robust": self._references(self.level_dbm), "paper": self._references(offsets)}
        made = Alignment(
            alignment_id,
            epoch_us,
            Axes(*angles_deg),
            Axes(0.01, 0.005, 0.005),
            calibration_id,
            "star_tracker",
            epoch_us,
            "me",
            reported["robust"],
            Window(epoch_us - 900 * S, epoch_us + 1),
            references_by_method=reported,
            calibration_by_method=dict.fromkeys(reported, calibration_id),
        )
        return replace(made, **changes)

    def _references(self, level_dbm: FloatArray) -> tuple[CarrierReference, ...]:
        return tuple(
            CarrierReference(name, float(level), 0.02, 15, 0.0) for name, level in zip(self.ids, level_dbm, strict=True)
        )

    # ---- rows

    def measurement(self, epoch_us: int, angles_deg: Any = (0.0, 0.0, 0.0), **changes: Any) -> Measurement:
        """Return one row, received two seconds after its epoch."""
        power = self.power_dbm([epoch_us], angles_deg)[0]
        number = 100_000 + (epoch_us - START_US) // S
        return replace(Measurement(epoch_us, epoch_us + 2 * S, number, "sa-1", 1, power, None), **changes)

    def series(self, window: Window, angles_deg: Any = (0.0, 0.0, 0.0), step_s: int = 60) -> MeasurementSeries:
        """Return the rows of a window."""
        epochs_us = np.arange(window.start_us, window.stop_us, step_s * S)
        return MeasurementSeries(self.ids, epochs_us, self.power_dbm(epochs_us, angles_deg))
