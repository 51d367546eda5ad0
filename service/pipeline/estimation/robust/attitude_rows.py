"""Attitude rows of the robust method, and what they say of readings, torque and telemetry."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.filtering.filter_model import FilterSettings
from service.core.estimation.filtering.integrity import REASONS
from service.core.estimation.filtering.row import MIN_CARRIERS
from service.core.estimation.filtering.row_block import EXCLUSIONS, BlockResult
from service.core.estimation.filtering.state_changes import sensors_of
from service.core.estimation.snapshot import CarrierUse, Snapshots
from service.pipeline.config import ChainConfig
from service.pipeline.estimation.robust.model import RobustModel
from service.pipeline.estimation.row_inhibitions import INHIBITIONS
from service.pipeline.inputs.knowledge import Knowledge
from service.pipeline.inputs.known_motion import disturbance_of
from service.records.catalogue import Method
from service.records.levels.attitude import (
    NO_AXES,
    AttitudeRow,
    Axes,
    BoolArray,
    Disturbance,
    Exclusion,
    FloatArray,
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
#: by bit of `motion_advice`
_ADVICE_OF_BIT = (
    "momentum_refused",
    "momentum_jump",
    "momentum_silent",
    "polarimeter_refused",
    "polarimeter_moved",
    "polarimeter_silent",
    "rates_refused",
)


def filtered_rows(
    measurements: Sequence[Measurement],
    model: RobustModel,
    knowledge: Knowledge,
    result: BlockResult,
    is_without_orbit: BoolArray,
    *,
    is_catch_up: bool,
    config: ChainConfig,
) -> list[AttitudeRow]:
    """Return the archive's rows of a block of the filter.

    `is_without_orbit` (T,) says which rows the ephemeris does not reach.
    """
    whole = int(np.count_nonzero(model.is_used))
    made = []
    for number, (measurement, figures) in enumerate(zip(measurements, _figures(result.rows), strict=True)):
        epoch_us, used, rain_db = measurement.epoch_us, figures.carriers_used, figures.rain_db
        _, roll_deg, pitch_deg = figures.attitude_deg
        is_beyond = max(abs(roll_deg), abs(pitch_deg)) > config.interlock.model_range_deg
        is_lost = bool(is_without_orbit[number])
        inhibitions = _inhibitions(knowledge, epoch_us, figures.reasons, is_catch_up, is_beyond, is_lost)
        made.append(
            AttitudeRow(
                epoch_us=epoch_us,
                received_at_us=measurement.received_at_us,
                number=measurement.number,
                method=Method.ROBUST,
                attitude_deg=Axes(*figures.attitude_deg),
                sigma_deg=Axes(*figures.sigma_deg),
                rates_deg_s=Axes(*figures.rates_deg_s),
                status=Status.ACQUIRED if used >= MIN_CARRIERS else Status.EXPIRED,
                control_allowed=not inhibitions,
                control_allowed_axes=NO_AXES if inhibitions else (figures.is_yaw_allowed, True, True),
                inhibitions=inhibitions,
                carriers_used=used,
                excluded=() if used == whole else _exclusions(model, result.carriers[number]),
                downlink_fade=figures.is_raining,
                downlink_fade_db=rain_db if figures.is_raining else 0.0,
                common_db=figures.common_db,
                residual_rms_db=figures.residual_rms_db,
                calibration_id=model.calibration_id,
                alignment_id=model.alignment_id,
                protection_deg=Axes(*figures.protection_deg),
                nominal_protection_deg=Axes(*figures.nominal_deg),
                waiting_loss_deg=Axes(*figures.waiting_loss_deg),
                advice=_advice(model, knowledge, figures, epoch_us),
            )
        )
    return made


class _Figures(NamedTuple):
    """Figures of a row, named as in `RESULT`; triples in the order yaw, roll, pitch."""

    attitude_deg: list[float]
    sigma_deg: list[float]
    rates_deg_s: list[float]
    protection_deg: list[float]
    nominal_deg: list[float]
    waiting_loss_deg: list[float]
    carriers_used: int
    residual_rms_db: float
    is_raining: bool
    rain_db: float
    common_db: float
    reasons: int
    is_yaw_allowed: bool
    is_realignment_advised: bool
    is_torque_shown: bool
    motion_advice: int


def _figures(rows: NDArray[np.void]) -> Iterator[_Figures]:
    """Return the figures of rows of `RESULT`: arrays as a whole cost a tenth of their numbers one by one."""
    return map(_Figures._make, zip(*(rows[name].tolist() for name in _Figures._fields), strict=True))


def _inhibitions(
    knowledge: Knowledge,
    epoch_us: int,
    reasons: int,
    is_catch_up: bool,  # noqa: FBT001
    is_beyond: bool,  # noqa: FBT001
    is_without_orbit: bool,  # noqa: FBT001
) -> tuple[str, ...]:
    """Return what stands against control, in the usual order."""
    is_declared = bool(knowledge.operations) and bool(knowledge.inhibiting_operations(epoch_us))
    is_thrusting = bool(knowledge.thrusters) and knowledge.is_thrusting_undeclared(epoch_us)
    if not (reasons or is_catch_up or is_beyond or is_declared or is_thrusting or is_without_orbit):
        return ()
    standing = {REASONS[place] for place in range(len(REASONS)) if reasons >> place & 1}
    conditions = {
        "catch_up": is_catch_up,
        "operation": is_declared,
        "undeclared_operation": is_thrusting,
        "no_ephemeris": is_without_orbit,
        "beyond_validity": is_beyond,
    }
    standing |= {reason for reason, stands in conditions.items() if stands}
    return tuple(reason for reason in INHIBITIONS if reason in standing)


def _advice(model: RobustModel, knowledge: Knowledge, figures: _Figures, epoch_us: int) -> tuple[str, ...]:
    """Return what the operator should do while control goes on."""
    given = {"realign": figures.is_realignment_advised, "state_torque": figures.is_torque_shown}
    given["state_torque"] &= model.is_torque_unknown
    if figures.motion_advice or model.contradicted or model.is_rate_in_loop:
        given |= dict.fromkeys(sorted(model.contradicted), True)
        given["rates_in_loop"] = model.is_rate_in_loop and knowledge.has_rate(epoch_us)
        given |= {code: bool(figures.motion_advice >> place & 1) for place, code in enumerate(_ADVICE_OF_BIT)}
    return tuple([code for code, is_given in given.items() if is_given])


def _exclusions(model: RobustModel, carriers: NDArray[np.void]) -> tuple[Exclusion, ...]:
    """Return the carriers of the method that did not enter, each with its reason."""
    is_out = np.flatnonzero(model.is_used & ~carriers["is_used"])
    return tuple(Exclusion(model.carrier_ids[k], EXCLUSIONS[carriers["exclusion"][k]]) for k in is_out)


def late_row(measurement: Measurement, model: RobustModel, fixes: Snapshots, *, is_absent: BoolArray) -> AttitudeRow:
    """Return the archive's row of a snapshot; its angles stand alone and never lead to a torque."""
    is_fix = bool(np.isfinite(fixes.attitude_deg[0]).all())
    is_out = model.is_used & (fixes.use[0] == CarrierUse.EXCLUDED)
    excluded = [Exclusion(model.carrier_ids[k], "absent") for k in np.flatnonzero(model.is_used & is_absent)]
    excluded += [
        Exclusion(model.carrier_ids[k], "uplink_fade" if fixes.residual_db[0, k] < 0.0 else "step")
        for k in np.flatnonzero(is_out)
    ]
    is_used = np.isin(fixes.use[0], (CarrierUse.USED, CarrierUse.GROUP_MOVED)) & np.isfinite(fixes.residual_db[0])
    left_db = fixes.residual_db[0, is_used]
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
        residual_rms_db=float(np.sqrt(np.mean(left_db**2))) if len(left_db) else float("nan"),
        calibration_id=model.calibration_id,
        alignment_id=model.alignment_id,
    )


def known_disturbance(torque_deg_h2: FloatArray, model: RobustModel, epoch_us: int) -> Disturbance | None:
    """Return a torque (4, 3) that acts without being fed forward, its phase zero at an epoch; None = there is none."""
    if model.inertia_kg_m2 is None or not model.is_pushed:
        return None
    return disturbance_of(torque_deg_h2, model.settings, model.inertia_kg_m2, epoch_us)


def torque_of(settings: FilterSettings) -> tuple[object, ...]:
    """Return what the states of torque and sensors begin with."""
    return settings.torque_deg_h2, settings.fed_forward, *sensors_of(settings)
