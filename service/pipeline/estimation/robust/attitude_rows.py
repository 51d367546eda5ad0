"""Attitude rows of the robust method, and what they say of readings, torque and telemetry."""

import math
from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.attitude_filter import FilterStep
from service.core.estimation.filtering.carrier_watch import QUIET_ROWS, QUIET_STD_DB
from service.core.estimation.filtering.declared import Declared
from service.core.estimation.filtering.filter_model import FilterSettings, common_states
from service.core.estimation.filtering.filter_state import FilterState
from service.core.estimation.filtering.motion_sensor import SensorWatch
from service.core.estimation.filtering.plant import sensor_states
from service.core.estimation.filtering.rate_sensor import RateWatch
from service.core.estimation.filtering.row import MIN_CARRIERS
from service.core.estimation.filtering.state_changes import is_torque_seen, sensors_of, torque_states
from service.core.estimation.filtering.wheel_momentum import momentum_advice
from service.core.estimation.snapshot.snapshot import CarrierUse, Snapshots
from service.pipeline.estimation.robust.model import RobustModel
from service.pipeline.estimation.row_inhibitions import INHIBITIONS
from service.pipeline.inputs.knowledge import Knowledge
from service.pipeline.inputs.known_motion import disturbance_of
from service.records.catalogue import Method
from service.records.epoch import US_PER_S
from service.records.levels.attitude import (
    NO_AXES,
    AttitudeRow,
    BoolArray,
    Disturbance,
    Exclusion,
    FloatArray,
    IntArray,
    Status,
    named_axes,
)
from service.records.levels.measurement import Measurement

#: what the operator should do while control goes on, with what each code says
ADVICE: dict[str, str] = {
    "realign": "more than a third of the references were learned again since the alignment; align again",
    "state_torque": "a torque of which the catalogue knows nothing turns the spacecraft, and yaw is known worse for "
    "it; state its size in onboard.residual_torque_n_m, and in onboard.fed_forward_torque the profile that the loop on "
    "board feeds forward",
    "momentum_contradicted": "the calibration turns contradict the momentum of the wheels in telemetry, and the filter "
    "does not use it; read the warnings of the calibration, correct sign, order, unit or epochs, and calibrate again",
    "momentum_refused": "the momentum of the wheels in telemetry contradicts the powers and is not used until the next "
    "alignment; check sign, order, unit and source of the telemetry, and onboard.momentum",
    "rates_contradicted": "the calibration turns contradict the rates of the body in telemetry, and the filter does "
    "not use them; read the warnings of the calibration, correct sign, order or unit, and calibrate again",
    "rates_refused": "the rates of the body in telemetry contradict the powers or the commands, or are no better than "
    "the inertial model, and are not used until the next alignment; check the telemetry, and onboard.rate_sensor",
    "rates_in_loop": "the rates of the body in telemetry are those of the sensor that the loop on board holds still: "
    "they tell nothing new and are not used; report a sensor beside the loop, or send none",
    "momentum_jump": "the momentum of the wheels jumped and telemetry did not say thrusters_active; report unloadings",
    "momentum_silent": "no new momentum of the wheels has been used for three hours, and yaw is known as without it; "
    "send records within 15 min, with a value that changes for each wheel of the catalogue",
    "polarimeter_refused": "a polarimeter contradicts the powers and is not used until the next alignment; check the "
    "sign of its angle, its feed offset, its station and its sigma figures in polarimeters",
    "polarimeter_contradicted": "the calibration turns contradict a polarimeter, and the filter does not use it; read "
    "the warnings of the calibration, correct the sign of feed_offset_deg, the feed or the ratio, and calibrate again",
    "polarimeter_moved": "the angle of a polarimeter jumped while its co-polar power was quiet: its feed was moved or "
    "its receiver changed; its offset is learned again",
    "polarimeter_silent": "no angle of a polarimeter has been of use for three hours, and yaw is known as without it: "
    "none came in time, they repeat, or its co-polar power is more than 5 dB off that of clear sky; check receiver, "
    "feed and link, and align again if the power stays so",
}
#: advice that alarms: what measures motion is left out, or jumped
MOTION_ADVICE = tuple(
    code for code in ADVICE if code.startswith(("momentum_", "rates_", "polarimeter_")) and code != "rates_in_loop"
)
#: fewest rows of a flagged carrier from which its kind of fault is told
_INFORMATIVE_ROWS = QUIET_ROWS // 2
_MIN_GROUP = 3


class Fixed(NamedTuple):
    """A filtered row before it is put into words."""

    announced: FilterStep
    #: (N,) dB
    deviation_db: FloatArray
    #: (N,) carriers whose reading stands still
    is_frozen: BoolArray
    #: (3,) deg/s
    rates_deg_s: FloatArray
    declared: Declared | None
    #: whether the ephemeris does not reach the row
    is_without_ephemeris: bool
    #: (N,) dB, beside attitude and common level
    residual_db: FloatArray


def filtered_row(
    measurement: Measurement,
    model: RobustModel,
    fixed: Fixed,
    *,
    is_catch_up: bool,
    has_inhibiting_operation: bool,
    is_thrusting_undeclared: bool,
    range_deg: float,
    given: dict[str, bool],
) -> AttitudeRow:
    """Return the archive's row of one step of the filter."""
    announced = fixed.announced
    conditions = {
        "catch_up": is_catch_up,
        "operation": has_inhibiting_operation,
        "undeclared_operation": is_thrusting_undeclared,
        "no_ephemeris": fixed.is_without_ephemeris,
        "beyond_validity": max(map(abs, announced.attitude_deg[1:].tolist())) > range_deg,
    }
    standing = {*announced.integrity.reasons, *(reason for reason, stands in conditions.items() if stands)}
    # whatever the filter holds against control stands, in the usual order where it has one
    in_order = (*INHIBITIONS, *announced.integrity.reasons) if standing else ()
    inhibitions = tuple(dict.fromkeys(one for one in in_order if one in standing))
    advice = {"realign": announced.integrity.is_realignment_advised, **given}
    is_raining = bool(announced.state.watch["is_raining"][0])
    common = announced.state.mean[common_states(model.filter)]
    return AttitudeRow(
        epoch_us=measurement.epoch_us,
        received_at_us=measurement.received_at_us,
        number=measurement.number,
        method=Method.ROBUST,
        attitude_deg=named_axes(announced.attitude_deg),
        sigma_deg=named_axes(np.sqrt(announced.covariance_deg2.diagonal())),
        rates_deg_s=named_axes(fixed.rates_deg_s),
        status=Status.ACQUIRED if len(announced.used) >= MIN_CARRIERS else Status.EXPIRED,
        control_allowed=not inhibitions,
        control_allowed_axes=NO_AXES if inhibitions else announced.integrity.is_axis_allowed,
        inhibitions=inhibitions,
        carriers_used=len(announced.used),
        excluded=_exclusions(model, fixed),
        downlink_fade=is_raining,
        downlink_fade_db=float(announced.rain_db) if is_raining else 0.0,
        common_db=float(announced.common_db + common.sum()),
        residual_rms_db=_rms(fixed.residual_db[announced.used]),
        calibration_id=model.calibration_id,
        alignment_id=model.alignment_id,
        protection_deg=named_axes(announced.protection_deg),
        nominal_protection_deg=named_axes(announced.nominal_deg),
        waiting_loss_deg=named_axes(announced.waiting_loss_deg),
        advice=tuple(code for code, is_given in advice.items() if is_given),
    )


def late_row(measurement: Measurement, model: RobustModel, fixes: Snapshots, *, is_absent: BoolArray) -> AttitudeRow:
    """Return the archive's row of a snapshot; its angles stand alone and never lead to a torque."""
    is_fix = bool(np.isfinite(fixes.attitude_deg[0]).all())
    is_out = model.is_used & (fixes.use[0] == CarrierUse.EXCLUDED)
    excluded = [Exclusion(model.carrier_ids[k], "absent") for k in np.flatnonzero(model.is_used & is_absent)]
    excluded += [
        Exclusion(model.carrier_ids[k], "uplink_fade" if fixes.residual_db[0, k] < 0.0 else "step")
        for k in np.flatnonzero(is_out)
    ]
    used = np.isin(fixes.use[0], (CarrierUse.USED, CarrierUse.GROUP_MOVED))
    return AttitudeRow(
        epoch_us=measurement.epoch_us,
        received_at_us=measurement.received_at_us,
        number=measurement.number,
        method=Method.ROBUST,
        attitude_deg=named_axes(fixes.attitude_deg[0]),
        sigma_deg=named_axes(np.sqrt(np.diag(fixes.covariance_deg2[0]))),
        rates_deg_s=None,
        status=Status.ACQUIRED if is_fix else Status.INVALID,
        control_allowed=False,
        control_allowed_axes=NO_AXES,
        inhibitions=("late",) if is_fix else ("late", "no_fix"),
        carriers_used=int(fixes.carriers_used[0]),
        excluded=tuple(sorted(excluded)),
        downlink_fade=False,
        downlink_fade_db=0.0,
        common_db=float(fixes.common_db[0]),
        residual_rms_db=_rms(fixes.residual_db[0][used]),
        calibration_id=model.calibration_id,
        alignment_id=model.alignment_id,
    )


def _exclusions(model: RobustModel, fixed: Fixed) -> tuple[Exclusion, ...]:
    """Return the carriers of the method that did not enter, each with its reason."""
    if len(fixed.announced.used) == np.count_nonzero(model.is_used):
        return ()
    is_out = model.is_used.copy()
    is_out[fixed.announced.used] = False
    moved = _moved_groups(model, fixed)
    return tuple(Exclusion(model.carrier_ids[k], _reason(model, fixed, moved, int(k))) for k in np.flatnonzero(is_out))


def _reason(model: RobustModel, fixed: Fixed, moved: set[int], k: int) -> str:
    """Return why one carrier is out."""
    is_flagged, aside_db = fixed.announced.state.carriers["is_flagged"], fixed.announced.state.aside_db
    if fixed.declared is not None and fixed.declared.is_masked[k]:
        return "manual"
    if fixed.is_frozen[k]:
        return "frozen"
    if np.isnan(fixed.deviation_db[k]):
        return "absent"
    if is_flagged[k] and int(model.filter.transponder[k]) in moved:
        return "group"
    seen_db = aside_db[:, k]
    seen_db = seen_db[np.isfinite(seen_db)]
    if is_flagged[k] and len(seen_db) >= _INFORMATIVE_ROWS:
        if float(seen_db.std()) < QUIET_STD_DB:
            return "step"
        return "uplink_fade" if float(seen_db.mean()) < 0.0 else "interference"
    return "uplink_fade" if fixed.residual_db[k] < 0.0 else "interference"


def _moved_groups(model: RobustModel, fixed: Fixed) -> set[int]:
    """Return the transponders all of whose carriers are flagged."""
    flagged, labels = fixed.announced.state.carriers["is_flagged"], model.filter.transponder
    return {
        int(label)
        for label in np.unique(labels[flagged])
        if flagged[labels == label].all() and np.count_nonzero(labels == label) >= _MIN_GROUP
    }


def _rms(values: FloatArray) -> float:
    """Return the root mean square of the figures that are there, NaN when there are none."""
    present = values[np.isfinite(values)]
    return math.sqrt(float(present @ present) / len(present)) if len(present) else math.nan


#: rows of one reading, and how long they last, from which it is frozen
_ROWS = 20
_LASTING_US = 20 * 60 * US_PER_S
#: least change of a reading, dB, from which it is coarse, how fast small changes of before are forgotten, and the one
#: before the first, so that six readings far apart make a carrier coarse: two are a fade or a step
_COARSE_DB, _FORGETTING, _BEFORE_DB = 0.4, 1.05, 0.3


class LastReadings(NamedTuple):
    """Last reading of N carriers, how many rows it has lasted, and since when."""

    #: (N,) dBm, NaN = never read
    power_dbm: FloatArray
    #: (N,)
    rows: IntArray
    #: (N,) microseconds UTC
    since_us: IntArray
    #: (N,) dB, least change of the last hundred or so
    least_change_db: FloatArray


def no_readings(carriers: int) -> LastReadings:
    """Return the readings before the first row."""
    zeros = np.zeros(carriers, dtype=np.int64)
    return LastReadings(np.full(carriers, np.nan), zeros, zeros, np.full(carriers, _BEFORE_DB))


def push_readings(readings: LastReadings, power_dbm: FloatArray, epoch_us: int) -> LastReadings:
    """Return the readings after a row (N,); a carrier that is absent keeps its last one."""
    is_there = np.isfinite(power_dbm)
    is_new = is_there & (power_dbm != readings.power_dbm)
    change_db = np.where(is_new, np.abs(power_dbm - readings.power_dbm), np.nan)
    least_db = np.where(is_new, _FORGETTING * readings.least_change_db, readings.least_change_db)
    return LastReadings(
        np.where(is_there, power_dbm, readings.power_dbm),
        np.where(is_new, 1, readings.rows + is_there),
        np.where(is_new, epoch_us, readings.since_us),
        np.fmin(least_db, change_db),
    )


def frozen(readings: LastReadings, epoch_us: int) -> BoolArray:
    """Return which carriers (N,) have shown one reading for too long, or move in steps that are too large."""
    is_lasting = (readings.rows >= _ROWS) & (epoch_us - readings.since_us >= _LASTING_US)
    return np.asarray(is_lasting | (readings.least_change_db >= _COARSE_DB))


def is_torque_shown(state: FilterState, model: RobustModel, shares: int) -> bool:
    """Return whether the torque that nobody stated has shown itself, in the state or as motion."""
    positions = torque_states(model.filter, len(state.mean), shares, sensor_states(model.settings))
    is_followed = bool((state.watch["followed_minutes"] > 0.0).any())
    return is_followed or (positions is not None and is_torque_seen(state.gaussian, positions))


def known_disturbance(state: FilterState, model: RobustModel, shares: int) -> Disturbance | None:
    """Return the torque that acts without being fed forward, its phase zero at the newest row; None = there is none."""
    plant = model.arrays.plant[0]
    positions = torque_states(model.filter, len(state.mean), shares, plant["sensor_states"])
    if positions is None or model.inertia_kg_m2 is None or not plant["is_pushed"]:
        return None
    own = state.mean[positions], state.covariance[positions, positions]
    return disturbance_of(*own, model.settings, model.inertia_kg_m2, state.epoch_us)


def torque_of(settings: FilterSettings) -> tuple[object, ...]:
    """Return what the states of torque and sensors begin with."""
    return settings.torque_deg_h2, settings.fed_forward, *sensors_of(settings)


def telemetry_advice(
    model: RobustModel, knowledge: Knowledge, momentum: SensorWatch, rates: RateWatch, since_us: int, epoch_us: int
) -> dict[str, bool]:
    """Return which advice is given at an epoch of a filter that began at another."""
    return {
        **dict.fromkeys(sorted(model.contradicted), True),
        **momentum_advice(momentum, since_us, epoch_us, is_used=model.settings.momentum is not None),
        "rates_refused": rates.is_refused,
        "rates_in_loop": model.is_rate_in_loop and knowledge.has_rate(epoch_us),
    }
