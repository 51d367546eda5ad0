"""Model of the published method, L1 to L3: expected powers, sensitivities, and both with the motion as arrays.

The phase of the daily harmonic is counted from the latest ascending node of the ephemeris that holds; references
(`paper_alignment`) have the harmonic removed, so it enters with h = 0. A carrier without a reference has the deviation
NaN.
"""

import math
from dataclasses import dataclass

import numpy as np

from service.core.estimation.filtering.filter_model import FilterSettings, no_carriers
from service.core.estimation.filtering.plant import filter_model
from service.core.estimation.paper.downlink_fade import LIMITS
from service.core.estimation.paper.harmonic import evaluate_harmonic
from service.core.estimation.paper.loop_observer import lasting_deg2, loop_slopes
from service.core.estimation.paper.row import CARRIER, PaperArrays
from service.core.estimation.paper.snapshot import predict_deviation_db
from service.core.geometry.frames import AntennaDirection, station_direction
from service.core.geometry.line_of_sight import node_phase_rad
from service.pipeline.config import ChainConfig, RobustConfig
from service.pipeline.inputs.knowledge import Knowledge
from service.pipeline.inputs.known_motion import angle_inertia_kg_m2, motion_settings
from service.records.calibration import Alignment, Calibration, CarrierReference
from service.records.catalogue import CarrierPlan, Ephemeris, Method, Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import BoolArray, FloatArray

#: instants over the alignment window at which two harmonics are compared when references are re-derived
_REDERIVE_INSTANTS = 60


@dataclass(frozen=True)
class ExpectedPower:
    """Expected power of every carrier of a calibration as a function of node phase."""

    carrier_ids: tuple[str, ...]
    #: (N,) dBm, harmonic removed; NaN = no reference
    reference_dbm: FloatArray
    #: (N,) dB
    amplitude_db: FloatArray
    #: (N,) rad
    phase_rad: FloatArray


def harmonic_arrays(calibration: Calibration) -> tuple[FloatArray, FloatArray]:
    """Return amplitude (N,) in dB and phase (N,) in rad of a finished calibration."""
    carriers = calibration.result.carriers if calibration.result else ()
    return (
        np.array([carrier.harmonic.amplitude_db for carrier in carriers]),
        np.array([carrier.harmonic.phase_rad for carrier in carriers]),
    )


def harmonic_db(calibration: Calibration, ephemeris: Ephemeris, epochs_us: FloatArray) -> FloatArray:
    """Return the harmonic of every carrier, shape (T, N) in dB, at some epochs."""
    amplitude_db, phase_rad = harmonic_arrays(calibration)
    nodes_us = np.array(ephemeris.ascending_nodes_us, dtype=np.int64)
    phase = node_phase_rad(epochs_us.astype(np.int64), nodes_us, ephemeris.nodal_period_s)
    return evaluate_harmonic(phase, amplitude_db, phase_rad)


def expected_power(
    calibration: Calibration,
    alignment: Alignment,
    method: Method,
    ephemeris: Ephemeris,
    aligned_with: Calibration,
) -> ExpectedPower:
    """Return references and harmonic for a calibration under an alignment.

    When another calibration was active at the alignment (``aligned_with``), each reference is moved by the mean
    difference of the two harmonics over the alignment window, and by that of the two changes at the angles of the
    alignment: the mean power there stays what it was.
    """
    carrier_ids = tuple(carrier.id for carrier in calibration.result.carriers) if calibration.result else ()
    references = {item.carrier: item.reference_dbm for item in references_of(alignment, method)}
    reference_dbm = np.array([references.get(carrier, np.nan) for carrier in carrier_ids])
    if aligned_with.id != calibration.id and alignment.window is not None:
        instants = np.linspace(alignment.window.start_us, alignment.window.stop_us, _REDERIVE_INSTANTS)
        old_ids = [carrier.id for carrier in aligned_with.result.carriers] if aligned_with.result else []
        old_db = dict(zip(old_ids, harmonic_db(aligned_with, ephemeris, instants).mean(axis=0), strict=True))
        new_db = harmonic_db(calibration, ephemeris, instants).mean(axis=0)
        turned = np.array([alignment.attitude_deg])
        turned_db = answer_db(sensitivity_model(aligned_with), turned)[0]
        old_db = {name: old_db[name] + float(turned_db[k]) for k, name in enumerate(old_ids)}
        new_db = new_db + answer_db(sensitivity_model(calibration), turned)[0]
        reference_dbm = reference_dbm + np.array([old_db.get(c, np.nan) for c in carrier_ids]) - new_db
    amplitude_db, phase_rad = harmonic_arrays(calibration)
    return ExpectedPower(carrier_ids, reference_dbm, amplitude_db, phase_rad)


def references_of(alignment: Alignment, method: Method) -> tuple[CarrierReference, ...]:
    """Return the reference powers that an alignment set for a method."""
    return alignment.references_by_method.get(method.value, alignment.references)


@dataclass(frozen=True)
class SensitivityModel:
    """Sensitivities and noise of the carriers of a calibration, as arrays."""

    carrier_ids: tuple[str, ...]
    #: (N, 3) dB/deg for positive and negative angles
    plus_db_per_deg: FloatArray
    minus_db_per_deg: FloatArray
    #: (N,) whether the carrier enters the fix
    is_selected: BoolArray
    #: (N,) dB
    sigma_white_db: FloatArray
    #: (N, C) dB and s, zeros where a carrier has fewer parts
    sigma_coloured_db: FloatArray
    correlation_time_s: FloatArray


def sensitivity_model(calibration: Calibration) -> SensitivityModel:
    """Return the arrays of a finished calibration."""
    carriers = calibration.result.carriers if calibration.result else ()
    most = max((len(carrier.noise) for carrier in carriers), default=0)
    sigma_db, time_s = np.zeros((len(carriers), most)), np.zeros((len(carriers), most))
    for k, carrier in enumerate(carriers):
        for position, part in enumerate(carrier.noise):
            sigma_db[k, position], time_s[k, position] = part.sigma_db, part.correlation_time_s
    return SensitivityModel(
        tuple(carrier.id for carrier in carriers),
        np.array([carrier.sensitivity_plus_db_per_deg for carrier in carriers], dtype=np.float64).reshape(-1, 3),
        np.array([carrier.sensitivity_minus_db_per_deg for carrier in carriers], dtype=np.float64).reshape(-1, 3),
        np.array([carrier.selected for carrier in carriers], dtype=np.bool_),
        np.array([carrier.sigma_white_db for carrier in carriers], dtype=np.float64),
        sigma_db,
        time_s,
    )


def answer_db(model: SensitivityModel, angles_deg: FloatArray) -> FloatArray:
    """Return the calibrated change (T, N) in dB at attitudes (T, 3); an axis without coefficients changes nothing."""
    plus, minus = np.nan_to_num(model.plus_db_per_deg), np.nan_to_num(model.minus_db_per_deg)
    return predict_deviation_db(plus, minus, angles_deg)


@dataclass(frozen=True)
class PaperModel:
    """Model of the paper method from calibration and alignment; fixed until one of them changes."""

    carrier_ids: tuple[str, ...]
    #: nobody may write to them
    arrays: PaperArrays
    #: motion of the spacecraft
    motion: FilterSettings
    inertia_kg_m2: tuple[float, float, float] | None
    calibration_id: int
    alignment_id: int


def paper_model(
    knowledge: Knowledge, plan: CarrierPlan, aligned_with: Calibration, config: ChainConfig
) -> PaperModel | None:
    """Return the model that holds, or None while calibration, ephemeris or alignment is missing."""
    calibration = knowledge.calibration_for(Method.PAPER)
    if calibration is None or knowledge.ephemeris is None or knowledge.alignment is None:
        return None
    spacecraft = knowledge.spacecraft
    expected = expected_power(calibration, knowledge.alignment, Method.PAPER, knowledge.ephemeris, aligned_with)
    sensitivity, motion = sensitivity_model(calibration), _loop_motion(spacecraft, config.robust)
    direction = _station_directions(sensitivity.carrier_ids, spacecraft, plan)
    return PaperModel(
        sensitivity.carrier_ids,
        paper_arrays(expected, sensitivity, direction, motion, config),
        motion,
        None if spacecraft is None else angle_inertia_kg_m2(spacecraft),
        calibration.id,
        knowledge.alignment.id,
    )


def paper_arrays(
    expected: ExpectedPower,
    sensitivity: SensitivityModel,
    direction: AntennaDirection,
    motion: FilterSettings,
    config: ChainConfig,
) -> PaperArrays:
    """Return the model as compiled functions take it."""
    carriers, limits = np.zeros(len(sensitivity.carrier_ids), CARRIER), np.zeros(1, LIMITS)
    carriers["reference_dbm"], carriers["amplitude_db"] = expected.reference_dbm, expected.amplitude_db
    carriers["phase_rad"], carriers["is_selected"] = expected.phase_rad, sensitivity.is_selected
    carriers["white_sigma_db"] = sensitivity.sigma_white_db
    estimation, fade = config.estimation, config.fade
    limits["averaging_us"], limits["min_rows"] = _us(estimation.averaging_window_s), estimation.min_rows
    limits["gate_db"], limits["gate_sigma"] = estimation.uplink_gate_db, estimation.gate_sigma
    limits["min_carriers"], limits["max_gap_us"] = estimation.min_carriers, _us(estimation.max_gap_s)
    limits["fade_averaging_us"], limits["fade_depth_db"] = _us(fade.averaging_window_s), fade.depth_db
    limits["fade_share"], limits["fade_spread_ratio"] = fade.share, fade.spread_ratio
    limits["fade_entry_s"], limits["fade_exit_s"], limits["fade_max_gap_s"] = fade.entry_s, fade.exit_s, fade.max_gap_s
    limits["objection_us"] = _us(fade.entry_s + fade.averaging_window_s)
    plus, minus = np.ascontiguousarray(sensitivity.plus_db_per_deg), np.ascontiguousarray(sensitivity.minus_db_per_deg)
    slope = np.ascontiguousarray(loop_slopes(plus, minus, *direction))
    coloured_db = np.sqrt(np.square(sensitivity.sigma_coloured_db).sum(axis=1))[sensitivity.is_selected]
    usual_db = float(np.median(coloured_db)) if len(coloured_db) else 0.0
    return PaperArrays(
        limits,
        carriers,
        plus,
        minus,
        slope,
        sensitivity.sigma_coloured_db,
        sensitivity.correlation_time_s,
        lasting_deg2(slope, sensitivity.is_selected, usual_db),
        filter_model(no_carriers(), motion),
    )


def _us(seconds: float) -> int:
    return round(seconds * US_PER_S)


def _loop_motion(spacecraft: Spacecraft | None, config: RobustConfig) -> FilterSettings:
    """Return how the spacecraft moves; a torque that was called small would hold the estimate where nobody is.

    The robust filter looks for a greater torque when motion contradicts the statement. Nothing does here.
    """
    motion = motion_settings(spacecraft, config)
    yaw, roll, pitch = map(max, motion.torque_deg_h2, motion.unknown_torque_deg_h2)
    return motion._replace(torque_deg_h2=(yaw, roll, pitch))


def _station_directions(
    carrier_ids: tuple[str, ...], spacecraft: Spacecraft | None, plan: CarrierPlan
) -> AntennaDirection:
    """Return where the satellite sees the stations of some carriers; NaN where it does not."""
    stations = {carrier.id: carrier.station for carrier in plan.carriers}
    places = [
        (s.longitude_deg, s.latitude_deg) if (s := stations.get(name)) else (math.nan,) * 2 for name in carrier_ids
    ]
    longitude_deg, latitude_deg = np.array(places).reshape(-1, 2).T
    subsatellite_deg = math.nan if spacecraft is None else spacecraft.longitude_deg
    return station_direction(longitude_deg, latitude_deg, np.zeros(len(places)), subsatellite_deg)
