"""Model of the robust method from calibration, alignment and ephemeris; fixed until one of them changes."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from service.core.estimation.calibration.geometry_columns import QuadraticResponse, predict_deviation
from service.core.estimation.filtering.filter_model import CarrierModel, FilterSettings, RateSensorModel
from service.core.estimation.filtering.plant import FilterModel, IntegrityLimits, filter_model, is_pushed
from service.core.estimation.snapshot import subset_orders
from service.pipeline.carrier_model.expected_level import (
    ExpectedLevel,
    GeometryModel,
    carrier_model,
    daily_error_db,
    geometry_model,
)
from service.pipeline.carrier_model.level_control import centred_model, centred_response, member_groups
from service.pipeline.config import ChainConfig, InterlockConfig, RobustConfig
from service.pipeline.inputs.declared_operations import CarrierIndices
from service.pipeline.inputs.knowledge import Knowledge
from service.pipeline.inputs.known_motion import (
    angle_inertia_kg_m2,
    axis_accelerations_deg_h2,
    is_rate_in_loop,
    is_torque_unknown,
    momentum_model,
    motion_settings,
    rate_sensor_model,
    residual_torque_n_m,
)
from service.pipeline.inputs.polarization import OrbitTurn, polarimeter_models, used_polarimeters
from service.records.calibration import Alignment, Calibration, CalibrationResult, GeometryFit
from service.records.catalogue import Ephemeris, Method, Polarimeter, Spacecraft
from service.records.levels.attitude import BoolArray, FloatArray, IntArray

#: correlation time that stands for a wave of one day, s
_DAILY_TAU_S = 20_000.0
#: subsets from which the fix of a late row starts
_SUBSETS = 60
#: instants over the alignment window at which two calibrations are compared when references are re-derived
_REDERIVE_INSTANTS = 60

#: id, place and transponder of a carrier
Signal = tuple[str, str, str]


@dataclass(frozen=True, eq=False)
class RobustModel:
    """Model of a step of the robust method; N carriers in the calibration's order."""

    carrier_ids: tuple[str, ...]
    filter: CarrierModel
    settings: FilterSettings
    limits: IntegrityLimits
    response: QuadraticResponse
    orders: IntArray
    level: ExpectedLevel
    fit: GeometryFit
    names: CarrierIndices
    #: (N,) dB, reference level minus the calibration's level
    reference_offset_db: FloatArray
    #: (N,) dB
    reference_sigma_db: FloatArray
    #: (N,) whether the method uses the carrier, and whether its reference is known
    is_used: BoolArray
    is_referenced: BoolArray
    #: members of each level-controlled group
    groups: tuple[IntArray, ...]
    #: about yaw, roll and pitch; None while no spacecraft is known
    inertia_kg_m2: tuple[float, float, float] | None
    #: (W, 3) spin axes of the wheels, x roll, y pitch, z yaw; None while no spacecraft is known
    wheel_axes: FloatArray | None
    #: whether the catalogue does not state the size of the torque that is not fed forward
    is_torque_unknown: bool
    #: advice about measured motion that the filter would use if the turns did not contradict it
    contradicted: frozenset[str]
    #: that the filter uses, as its settings have them, and what the orbit turns about each line of sight
    polarimeters: tuple[Polarimeter, ...]
    orbit_turns: tuple[OrbitTurn, ...]
    #: rate sensor whose records move the angles; None = there is none, or it tells nothing new
    rate_sensor: RateSensorModel | None
    is_rate_in_loop: bool
    calibration_id: int
    alignment_id: int

    @cached_property
    def arrays(self) -> FilterModel:
        """Carriers, spacecraft, limits and sensors as the compiled filter takes them."""
        return filter_model(self.filter, self.settings, self.limits, self.rate_sensor)

    @cached_property
    def sigma_db(self) -> FloatArray:
        """Noise (N,) of one row of each carrier, dB."""
        return self.filter.sigma_db

    @cached_property
    def has_sensors(self) -> bool:
        """True where records of other sensors may change the state between two rows."""
        return bool(self.settings.momentum or self.settings.polarimeters or self.rate_sensor)

    @cached_property
    def is_pushed(self) -> bool:
        """True where a torque acts that is not fed forward."""
        return is_pushed(self.settings)

    def expected_dbm(self, epoch_us: int) -> FloatArray:
        """Return the level (N,) at zero attitude by calibration, ephemeris and references."""
        return self.level(epoch_us) + self.reference_offset_db

    def expected_rows_dbm(self, epochs_us: IntArray) -> FloatArray:
        """Return the levels (T, N) of some epochs."""
        return self.level.rows(epochs_us) + self.reference_offset_db


def robust_model(
    knowledge: Knowledge,
    aligned_with: Calibration | None,
    config: ChainConfig,
    aligned_under: Ephemeris | None = None,
) -> RobustModel | None:
    """Return the model that holds, or None while calibration, ephemeris or alignment is missing.

    Parameters
    ----------
    knowledge : Knowledge
        What the slow inputs told.
    aligned_with : Calibration or None
        Calibration that the references of the alignment were made with.
    config : ChainConfig
        Settings.
    aligned_under : Ephemeris, optional
        Orbit that held at the alignment; a later one need not reach back to it.
    """
    calibration = knowledge.calibration_for(Method.ROBUST)
    alignment, ephemeris, spacecraft = knowledge.alignment, knowledge.ephemeris, knowledge.spacecraft
    if calibration is None or calibration.result is None or alignment is None or ephemeris is None:
        return None
    result, fit = calibration.result, calibration.result.geometry
    if fit is None or Method.ROBUST.value not in alignment.references_by_method:
        return None
    arrays = geometry_model(fit)
    former = aligned_with if aligned_with is not None and aligned_with.id != calibration.id else None
    offset_db, sigma_db = _references(result, fit, arrays, alignment, former, aligned_under or ephemeris)
    carrier_ids = tuple(carrier.id for carrier in result.carriers)
    is_known = np.isfinite(arrays.response.slope).all(axis=1) & np.isfinite(np.array(fit.level_dbm))
    is_used = np.array(fit.is_used, dtype=np.bool_) & is_known
    groups = member_groups(fit.alc_group, is_used)
    grown_db = _grown_error_db(arrays, fit, ephemeris, max(alignment.epoch_us, ephemeris.valid_start_us))
    carriers = centred_model(carrier_model(arrays, fit, result.carriers, config.robust), groups)
    settings = _filter_settings(spacecraft, config.robust, calibration, alignment.epoch_us)
    return RobustModel(
        carrier_ids=carrier_ids,
        filter=_with_daily_error(carriers, grown_db),
        settings=settings,
        limits=_limits(config.interlock, config.robust),
        response=centred_response(arrays.response, groups),
        orders=subset_orders(len(carrier_ids), _SUBSETS),
        level=ExpectedLevel(arrays, fit, ephemeris),
        fit=fit,
        names=CarrierIndices(carrier_ids, fit.transponders, np.array(fit.transponder, dtype=np.int64)),
        reference_offset_db=np.nan_to_num(offset_db),
        # the reference holds what the daily change had wrong at the alignment
        reference_sigma_db=np.hypot(sigma_db, grown_db),
        is_used=is_used,
        is_referenced=np.isfinite(offset_db),
        groups=groups,
        inertia_kg_m2=None if spacecraft is None else angle_inertia_kg_m2(spacecraft),
        wheel_axes=None if spacecraft is None else np.array(spacecraft.wheels.axes),
        is_torque_unknown=is_torque_unknown(spacecraft),
        contradicted=_contradicted(spacecraft, calibration),
        polarimeters=used_polarimeters(spacecraft, calibration.contradicted_polarimeters),
        orbit_turns=tuple(
            OrbitTurn(ephemeris, spacecraft, each.sight) for each in settings.polarimeters if spacecraft is not None
        ),
        rate_sensor=rate_sensor_model(spacecraft, is_contradicted=calibration.is_rates_contradicted),
        is_rate_in_loop=is_rate_in_loop(spacecraft),
        calibration_id=calibration.id,
        alignment_id=alignment.id,
    )


def _grown_error_db(arrays: GeometryModel, fit: GeometryFit, ephemeris: Ephemeris, start_us: int) -> FloatArray:
    """Return by how much (N,) the daily change is known worse than over the orbit of the quiet days, dB.

    Over that orbit dish and solar day share one wave, and only their sum was measured: what the dish alone leaves open
    there is no error of the level.
    """
    now_db = daily_error_db(arrays, fit, ephemeris, start_us)
    then_db = np.array(fit.daily_error_db) if fit.daily_error_db else np.zeros_like(now_db)
    return np.sqrt(np.maximum(now_db**2 - np.nan_to_num(then_db) ** 2, 0.0))


def _with_daily_error(model: CarrierModel, error_db: FloatArray) -> CarrierModel:
    """Return the carriers with the error of their daily change in the coloured part that lasts as long."""
    component = np.abs(np.log(model.coloured_tau_s / _DAILY_TAU_S)).argmin(axis=1)
    sigma_db = model.coloured_sigma_db.copy()
    at = np.arange(model.carriers)
    sigma_db[at, component] = np.hypot(sigma_db[at, component], error_db)
    # the filter's compiled stages know arrays in one piece
    return CarrierModel._make(map(np.ascontiguousarray, model._replace(coloured_sigma_db=sigma_db)))


def _references(
    result: CalibrationResult,
    fit: GeometryFit,
    arrays: GeometryModel,
    alignment: Alignment,
    aligned_with: Calibration | None,
    ephemeris: Ephemeris,
) -> tuple[FloatArray, FloatArray]:
    """Return reference minus level (N,) and its sigma; NaN for a carrier that the alignment did not see.

    References made with another calibration, ``aligned_with``, are moved so that each mean power of the alignment
    window stays what it was: by the difference of the two expected levels there, and of what the two say the attitude
    did. Both are taken under the ephemeris of the alignment.
    """
    announced = {item.carrier: item for item in alignment.references_by_method.get(Method.ROBUST.value, ())}
    ids = [carrier.id for carrier in result.carriers]
    level_dbm = np.array(arrays.calibration.level_dbm)
    reference_dbm = np.array([announced[c].reference_dbm if c in announced else np.nan for c in ids])
    sigma_db = np.array([announced[c].sigma_db if c in announced else np.nan for c in ids])
    offset_db = reference_dbm - level_dbm
    if aligned_with is not None and aligned_with.result is not None:
        former = _at_alignment(aligned_with.result, alignment, ephemeris)
        unknown = (np.nan, np.nan)
        state_of = np.array([former.get(signal, unknown) for signal in signals(ids, fit)]).reshape(-1, 2)
        now_dbm = _window_levels(arrays, ExpectedLevel(arrays, fit, ephemeris), alignment)
        offset_db = reference_dbm - state_of[:, 0] + state_of[:, 1] - now_dbm
    return offset_db, np.where(np.isfinite(sigma_db), sigma_db, 1.0)


def signals(carrier_ids: Sequence[str], fit: GeometryFit) -> list[Signal]:
    """Return the identity of the signals of a calibration: an id may be given to another station's carrier later."""
    positions = zip(fit.station_latitude_deg, fit.station_longitude_deg, fit.transponder, strict=True)
    # a beacon has no place, and NaN is not equal to itself
    return [
        (name, f"{latitude_deg}/{longitude_deg}", fit.transponders[number])
        for name, (latitude_deg, longitude_deg, number) in zip(carrier_ids, positions, strict=True)
    ]


def _at_alignment(
    result: CalibrationResult, alignment: Alignment, ephemeris: Ephemeris
) -> dict[Signal, tuple[float, float]]:
    """Return level and expected mean over the alignment window of each carrier of the calibration aligned with."""
    fit = result.geometry
    if fit is None:
        return {}
    arrays = geometry_model(fit)
    means = _window_levels(arrays, ExpectedLevel(arrays, fit, ephemeris), alignment)
    names = signals([carrier.id for carrier in result.carriers], fit)
    return {name: (float(fit.level_dbm[k]), float(means[k])) for k, name in enumerate(names)}


def _window_levels(arrays: GeometryModel, level: ExpectedLevel, alignment: Alignment) -> FloatArray:
    """Return the mean level (N,) over the alignment window at the alignment's attitude."""
    window = alignment.window
    start_us, stop_us = (window.start_us, window.stop_us) if window else (alignment.epoch_us, alignment.epoch_us)
    instants = np.linspace(start_us, stop_us, _REDERIVE_INSTANTS).astype(np.int64)
    attitude = np.nan_to_num(np.array(alignment.attitude_deg))
    return level.mean_dbm(instants) + predict_deviation(attitude, arrays.response)


def _contradicted(spacecraft: Spacecraft | None, calibration: Calibration) -> frozenset[str]:
    """Return the advice about what the catalogue would have used, and the turns contradict."""
    left_out = {
        "momentum_contradicted": calibration.is_momentum_contradicted and momentum_model(spacecraft) is not None,
        "rates_contradicted": calibration.is_rates_contradicted and rate_sensor_model(spacecraft) is not None,
        "polarimeter_contradicted": any(
            each.source in calibration.contradicted_polarimeters for each in used_polarimeters(spacecraft)
        ),
    }
    return frozenset(name for name, is_left_out in left_out.items() if is_left_out)


def _filter_settings(
    spacecraft: Spacecraft | None, config: RobustConfig, calibration: Calibration, aligned_us: int
) -> FilterSettings:
    settings, momentum = motion_settings(spacecraft, config), momentum_model(spacecraft, calibration, aligned_us)
    if momentum is not None:
        # the momentum of the wheels tells a torque: none is none
        residual_n_m = residual_torque_n_m(spacecraft, config.unknown_torque_n_m, 0.0)
        settings = settings._replace(torque_deg_h2=axis_accelerations_deg_h2(spacecraft, residual_n_m))
    return settings._replace(
        chain_walk_db=config.chain_walk_db_sqrt_h,
        momentum=momentum,
        polarimeters=polarimeter_models(
            spacecraft, used_polarimeters(spacecraft, calibration.contradicted_polarimeters), calibration, aligned_us
        ),
    )


def _limits(interlock: InterlockConfig, config: RobustConfig) -> IntegrityLimits:
    """Return when control may use the attitude."""
    return IntegrityLimits(
        sigma_yaw_deg=config.yaw_sigma_limit_deg,
        sigma_roll_deg=interlock.roll_sigma_limit_deg,
        sigma_pitch_deg=interlock.pitch_sigma_limit_deg,
        alert_deg=interlock.alert_limit_deg,
        redundancy=interlock.min_redundancy,
        nis_ratio=config.innovation_limit,
        relearned_share=config.relearned_share,
    )
