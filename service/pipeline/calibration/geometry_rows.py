"""Windows of a calibration and their rows."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.core.estimation.calibration.calibration_bins import SmoothedAngles, smoothed_angles
from service.core.estimation.calibration.geometry_calibration import CalibrationRows
from service.core.estimation.calibration.geometry_columns import CarrierGeometry, OrbitMotion
from service.core.estimation.paper.harmonic import HarmonicFits, evaluate_harmonic
from service.core.geometry.frames import station_direction
from service.core.geometry.line_of_sight import (
    Positions,
    antenna_motion_deg,
    latest_node_us,
    node_phase_rad,
    sight_motion_deg,
    track_position_deg,
)
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.polarization import predicted_track
from service.pipeline.inputs.sensor_angles import angles_at
from service.records.calibration import CalibrationRequest, Window
from service.records.catalogue import CarrierPlan, Ephemeris, Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import Correction, Operation, PolarizationRecord, TelemetryRecord
from service.records.levels.attitude import BoolArray, FloatArray, IntArray
from service.records.levels.measurement import MeasurementSeries, ReferenceSeries

_AXIS_NAMES = ("yaw", "roll", "pitch")


class CalibrationError(Exception):
    """The windows do not hold what a calibration needs; the text says what is missing and what to do."""


@dataclass(frozen=True)
class CalibrationInput:
    """Data of the archive for a calibration request."""

    request: CalibrationRequest
    plan: CarrierPlan
    ephemeris: Ephemeris
    quiet: MeasurementSeries
    turns: MeasurementSeries
    #: of the turns
    references: tuple[ReferenceSeries, ...]
    #: of the quiet window; the paper method does without
    quiet_references: tuple[ReferenceSeries, ...] = ()
    #: positions of satellite and receiving site; the paper method does without
    spacecraft: Spacecraft | None = None
    #: declared, overlapping one of the windows
    operations: tuple[Operation, ...] = ()
    #: announced, within the turns
    corrections: tuple[Correction, ...] = ()
    #: measurements behind a row of the quiet window; above 1 rows are means (`minute_rows`)
    row_measurements: float = 1.0
    #: (T, N) dBm, of each row of the quiet window its first measurement; None = the row is the measurement
    quiet_first_dbm: FloatArray | None = None
    #: records of the quiet days and of the turns
    telemetry: tuple[TelemetryRecord, ...] = ()
    polarization: tuple[PolarizationRecord, ...] = ()
    #: powers around the turns, by which a lag is judged that is longer than they are
    around: MeasurementSeries | None = None

    @property
    def sensors(self) -> tuple[str, str, str]:
        """Sensor of yaw, roll, pitch."""
        request = self.request
        return request.source_yaw, request.source_roll, request.source_pitch

    @property
    def white_scale(self) -> float:
        """White noise of a measurement over that of a row."""
        return math.sqrt(self.row_measurements)

    def angles_deg(self, epochs_us: IntArray, config: CalibrationConfig) -> FloatArray:
        """Return yaw, roll, pitch (T, 3) of the sensors at some epochs of both windows, deg."""
        return angles_at(epochs_us, self.quiet_references + self.references, self.sensors, config)

    def momentum_records(self, window: Window) -> list[TelemetryRecord]:
        """Return the records of a window that tell the momentum of every wheel, in order of their epochs."""
        wheels = 0 if self.spacecraft is None else len(self.spacecraft.wheels.axes)
        within = (one for one in self.telemetry if window.start_us <= one.epoch_us < window.stop_us)
        whole = (one for one in within if len(one.wheel_momentum_n_m_s or ()) == wheels)
        return sorted(whole, key=lambda one: one.epoch_us)


def epochs_of(records: Sequence[TelemetryRecord | PolarizationRecord]) -> IntArray:
    """Return the epochs (K,) of records, microseconds UTC."""
    return np.array([one.epoch_us for one in records], dtype=np.int64)


@dataclass(frozen=True)
class TurnRows:
    """Rows of the turns with known angles."""

    #: (K,) s since the first row
    time_s: FloatArray
    #: (K, 3) deg, yaw, roll, pitch
    angles_deg: FloatArray
    #: (K, N) dB, level and harmonic removed
    deviation_db: FloatArray


def phase_rad(ephemeris: Ephemeris, epochs_us: IntArray) -> FloatArray:
    """Return the node phase (T,) in rad."""
    return node_phase_rad(epochs_us, np.array(ephemeris.ascending_nodes_us, dtype=np.int64), ephemeris.nodal_period_s)


def node_us(ephemeris: Ephemeris, epoch_us: int) -> int:
    """Return the ascending node from which the phase of an epoch is counted."""
    nodes_us = np.array(ephemeris.ascending_nodes_us, dtype=np.int64)
    return int(latest_node_us(np.array([epoch_us]), nodes_us, ephemeris.nodal_period_s)[0])


def turn_rows(
    data: CalibrationInput, fits: HarmonicFits, config: CalibrationConfig, *, is_every_axis_needed: bool
) -> TurnRows:
    """Return the rows of the turns that have a sensor reading nearby, level and harmonic of the quiet days removed.

    Raises
    ------
    CalibrationError
        Too few rows, too few of them with angles, or, where every axis is needed, one not turned to both sides.
    """
    epochs_us = data.turns.epochs_us
    angles = angles_at(epochs_us, data.references, data.sensors, config)
    present = np.asarray(np.isfinite(angles).all(axis=1))
    _require_rows("window of turns", present, config.min_turn_rows, data.sensors)
    missing = unturned_sides(angles[present], config)
    if missing and is_every_axis_needed:
        message = (
            f"no turn of at least {config.min_turn_deg} deg towards {', '.join(missing)} in the window of turns; "
            "a sensitivity for each sign of each axis needs one"
        )
        raise CalibrationError(message)
    harmonic = evaluate_harmonic(phase_rad(data.ephemeris, epochs_us), fits.amplitude_db, fits.phase_rad)
    deviation = data.turns.power_dbm - fits.offset_dbm - harmonic
    time_s = (epochs_us - epochs_us[0]) / US_PER_S
    return TurnRows(time_s[present], angles[present], deviation[present])


def unturned_sides(angles_deg: FloatArray, config: CalibrationConfig) -> list[str]:
    """Return the sides, like ``-roll``, towards which turns (K, 3) never moved."""
    lowest, highest = angles_deg.min(axis=0), angles_deg.max(axis=0)
    return [
        f"{'+' if side > 0 else '-'}{name}"
        for name, low, high in zip(_AXIS_NAMES, lowest, highest, strict=True)
        for side, reach in ((1, high), (-1, -low))
        if reach < config.min_turn_deg
    ]


def median_present(values: FloatArray) -> float:
    """Return the median of the figures that are there, NaN when there are none."""
    present = values[np.isfinite(values)]
    return float(np.median(present)) if len(present) else float("nan")


_DAY_US = 86_400 * US_PER_S
#: kinds of operation during which powers say nothing certain; turns are what a calibration is made of
DISTURBING = frozenset(
    {
        "station_keeping",
        "momentum_unloading",
        "eclipse",
        "sun_outage",
        "carrier_work",
        "gain_change",
        "receive_chain_work",
        "other",
    }
)


class PlanPositions(NamedTuple):
    """Positions of the stations of a plan; NaN for a beacon.

    Parameters
    ----------
    geometry : CarrierGeometry
        Antenna angles and bands.
    stations : Positions
        Stations and, last, the receiving site.
    bands : tuple of str
        Names of the bands.
    is_beacon : ndarray of bool, shape (N,)
        Carriers without a station.
    """

    geometry: CarrierGeometry
    stations: Positions
    bands: tuple[str, ...]
    is_beacon: BoolArray


@dataclass(frozen=True)
class GeometryRows:
    """Rows (T,) of both windows in order of time."""

    epochs_us: IntArray
    rows: CalibrationRows
    positions: PlanPositions
    angles: SmoothedAngles
    #: (T,) whether the row belongs to the quiet window alone
    is_quiet: BoolArray
    #: (T,) whether ballistics covers the row
    is_tracked: BoolArray


def geometry_rows(data: CalibrationInput, config: CalibrationConfig) -> GeometryRows:
    """Return the rows of both windows.

    Raises
    ------
    CalibrationError
        The place of the satellite is not known, or a window has too few rows with powers and angles.
    """
    if data.spacecraft is None:
        message = "the spacecraft of the calibration is not known; the geometry of the stations needs its longitude"
        raise CalibrationError(message)
    epochs_us, power_dbm = joined_rows(data)
    is_turn = inside(epochs_us, data.request.turns)
    if not len(epochs_us):
        message = "neither window holds a measurement; choose windows of the archive that have some"
        raise CalibrationError(message)
    angles = smoothed_angles((epochs_us - epochs_us[0]) / US_PER_S, data.angles_deg(epochs_us, config))
    has_angles = np.asarray(np.isfinite(angles.attitude_deg).all(axis=1))
    _require_rows("quiet window", has_angles[~is_turn], config.min_quiet_rows, data.sensors)
    _require_rows("window of turns", has_angles[is_turn], config.min_turn_rows, data.sensors)
    _require_turns(angles.attitude_deg[is_turn], config)
    positions = plan_positions(data.plan, data.spacecraft)
    motion = orbit_motion(data, epochs_us, positions)
    rows = CalibrationRows(
        (epochs_us - epochs_us[0]) / US_PER_S,
        undisturbed(power_dbm, epochs_us, data.plan, data.operations),
        angles.attitude_deg,
        phase_rad(data.ephemeris, epochs_us),
        motion,
        ~is_turn,
        float(epochs_us[0] % _DAY_US) / US_PER_S,
    )
    sight_deg = np.full((len(epochs_us), 1, 2), np.nan) if motion is None else motion.sight_deg
    is_tracked = np.asarray(np.isfinite(sight_deg).all(axis=(1, 2)))
    return GeometryRows(epochs_us, rows, positions, angles, ~is_turn, is_tracked)


def plan_positions(plan: CarrierPlan, spacecraft: Spacecraft) -> PlanPositions:
    """Return where stations and receiving site stand, on the ground and in the antenna frame."""
    site = spacecraft.receiving_site
    stations = [carrier.station for carrier in plan.carriers]
    is_beacon = np.array([station is None for station in stations], dtype=np.bool_)
    latitude_deg = np.array([np.nan if s is None else s.latitude_deg for s in stations] + [site.latitude_deg])
    longitude_deg = np.array([np.nan if s is None else s.longitude_deg for s in stations] + [site.longitude_deg])
    height_m = np.append(np.zeros(len(stations)), site.height_m)
    azimuth_deg, elevation_deg = station_direction(longitude_deg, latitude_deg, height_m, spacecraft.longitude_deg)
    bands = tuple(sorted({carrier.band for carrier in plan.carriers}))
    band = np.array([bands.index(carrier.band) for carrier in plan.carriers], dtype=np.int64)
    site_deg = np.array([azimuth_deg[-1], elevation_deg[-1]])
    if np.isnan(site_deg).any():
        message = f"the receiving site does not see a satellite at {spacecraft.longitude_deg:g} degrees East"
        raise CalibrationError(message)
    geometry = CarrierGeometry(azimuth_deg[:-1], elevation_deg[:-1], site_deg, band)
    return PlanPositions(geometry, Positions(latitude_deg, longitude_deg, height_m), bands, is_beacon)


def orbit_motion(data: CalibrationInput, epochs_us: IntArray, positions: PlanPositions) -> OrbitMotion | None:
    """Return the motion by ballistics at some epochs; None without a track."""
    reported, spacecraft = data.ephemeris.track, data.spacecraft
    if reported is None or spacecraft is None or len(reported.epochs_us) < 4:
        return None
    track = predicted_track(reported)
    stations = Positions(*(values[:-1] for values in positions.stations))
    is_placeless = np.isnan(positions.geometry.azimuth_deg)
    sight = sight_motion_deg(track_position_deg(track, epochs_us), stations, spacecraft.longitude_deg)
    antenna = antenna_motion_deg(track, epochs_us, positions.stations, spacecraft.longitude_deg)
    # a beacon has no dish and no beam of its own to move in; it is as little known as the rest outside the track
    still = (0.0 * antenna[:, -1:]).sum(axis=-1, keepdims=True)
    sight[:, is_placeless] = still
    antenna[:, np.append(is_placeless, False)] = still
    return OrbitMotion(sight, antenna)


def joined_rows(data: CalibrationInput, *, is_around: bool = False) -> tuple[IntArray, FloatArray]:
    """Return epochs and powers of both windows and, where asked for, around the turns, each epoch once."""
    parts = (data.quiet, data.turns, *((data.around,) if is_around and data.around is not None else ()))
    epochs_us = np.concatenate([one.epochs_us for one in parts])
    power_dbm = np.concatenate([one.power_dbm for one in parts])
    unique_us, first = np.unique(epochs_us, return_index=True)
    return unique_us, power_dbm[first].astype(np.float64)


def inside(epochs_us: IntArray, window: Window) -> BoolArray:
    """Return which epochs lie in a window."""
    return np.asarray((epochs_us >= window.start_us) & (epochs_us < window.stop_us))


def _require_rows(name: str, has_angles: BoolArray, least: int, sensors: tuple[str, ...]) -> None:
    """Refuse a window without enough rows (T,), or without enough that have angles."""
    known = int(np.count_nonzero(has_angles))
    if len(has_angles) < least:
        message = f"the {name} holds {len(has_angles)} measurements, {least} are needed"
        raise CalibrationError(message)
    if known < least:
        message = (
            f"only {known} rows of the {name} have angles of {', '.join(sorted(set(sensors)))}; {least} are needed: "
            "send the sensor's references or name another source"
        )
        raise CalibrationError(message)


def _require_turns(attitude_deg: FloatArray, config: CalibrationConfig) -> None:
    """Refuse turns that moved neither roll nor pitch."""
    missing = unturned_sides(attitude_deg[np.isfinite(attitude_deg).all(axis=1)], config)
    if {"+roll", "-roll", "+pitch", "-pitch"} <= set(missing):
        message = (
            f"no turn of at least {config.min_turn_deg} deg in roll or pitch in the window of turns; "
            "the beams of the carriers are not known without one"
        )
        raise CalibrationError(message)


def undisturbed(
    power_dbm: FloatArray, epochs_us: IntArray, plan: CarrierPlan, operations: tuple[Operation, ...]
) -> FloatArray:
    """Return the powers with NaN where a declared operation disturbs them."""
    power_dbm = power_dbm.copy()
    for operation in operations:
        if operation.kind in DISTURBING:
            stop_us = operation.start_us if operation.stop_us is None else operation.stop_us
            is_during = (epochs_us >= operation.start_us) & (epochs_us < stop_us)
            power_dbm[np.ix_(is_during, touched_carriers(plan, operation))] = np.nan
    return power_dbm


def touched_carriers(plan: CarrierPlan, operation: Operation) -> BoolArray:
    """Return which carriers (N,) an operation names; one that names none touches all."""
    if operation.carriers is None and operation.transponders is None:
        return np.ones(len(plan.carriers), dtype=np.bool_)
    names, groups = operation.carriers or (), operation.transponders or ()
    return np.array([carrier.id in names or carrier.transponder in groups for carrier in plan.carriers], dtype=np.bool_)
