"""Checks of what the spacecraft and the ground report, by the calibration turns, before the filter uses it.

Momentum of the wheels: sign, order and scale of the axes by their response to the turns; what all axes share, a unit or
one sign for all, by the momentum along pitch that the catalogue states. Rates of the body and polarimeters by their
response alone. The law of this file: an instrument is refused only where it is contradicted; what was not checked is
said with its reason.
"""

import math
from dataclasses import replace

import numpy as np

from service.core.estimation.calibration.responses import (
    AngleResponse,
    MomentumResponse,
    RateResponse,
    angle_response,
    feed_leakage,
    feed_turn,
    momentum_response,
    rate_response,
)
from service.pipeline.calibration.geometry_rows import CalibrationInput, epochs_of
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.known_motion import angle_inertia_kg_m2, is_rate_in_loop, rate_sensor_model
from service.pipeline.inputs.polarization import (
    every_block,
    line_of_sight,
    measured_angle_deg,
    noise_deg,
    orbit_turn_deg,
    polarimeter_models,
    used_polarimeters,
)
from service.pipeline.inputs.sensor_angles import inertial_deg_h
from service.records.calibration import AxesCheck, FeedFit, MotionVerdict, PolarimeterCheck, Window
from service.records.catalogue import Polarimeter, Spacecraft, WheelMomentum
from service.records.epoch import US_PER_S
from service.records.inputs import PolarizationRecord, TelemetryRecord
from service.records.levels.attitude import BoolArray, FloatArray, IntArray

#: sigmas from which telemetry is contradicted: true one stays within 3.0 on 24 seeds, and one axis wrong by 0.2 costs
#: yaw four times the error without it
_SIGMAS = 3.5
#: the spacecraft slews where its angles change by more in two minutes, deg
_SLEW_DEG, _HALF_US = 0.05, 60 * US_PER_S
#: records around the turns that are needed, and momentum along pitch below which turns move nothing, N m s
_LEAST_RECORDS, _LEAST_N_M_S = 20, 1.0
_NEXT = (
    "the filter does not use it under this calibration; correct sign, order of axes, unit or epochs of "
    "wheel_momentum_n_m_s, or onboard.momentum, send the records of the turns again and calibrate again"
)


def momentum_check(data: CalibrationInput, config: CalibrationConfig) -> AxesCheck | None:
    """Return the check; None where the catalogue states nothing of the momentum."""
    spacecraft = data.spacecraft
    stated = None if spacecraft is None else spacecraft.onboard.momentum
    if spacecraft is None or stated is None:
        return None
    records = data.momentum_records(data.request.turns)
    if len(records) < _LEAST_RECORDS:
        return AxesCheck(MotionVerdict.UNCHECKED, _too_few("of momentum ", len(records)))
    return _judged(_response(data, records, spacecraft, config), stated, config)


def axes_quality(name: str, check: AxesCheck | None) -> dict[str, float]:
    """Return the figures of a check of three axes, by the name of what was checked."""
    if check is None:
        return {}
    named = zip(("roll", "pitch", "yaw"), check.response, check.response_sigma, strict=True)
    figures = {f"{name}_response_{axis}": (value, sigma) for axis, value, sigma in named if math.isfinite(sigma)}
    return {
        **{figure: value for figure, (value, _) in figures.items()},
        **{f"{figure}_sigma": sigma for figure, (_, sigma) in figures.items()},
    }


def momentum_warnings(check: AxesCheck | None) -> tuple[str, ...]:
    """Return the warnings of a check."""
    return _warnings("the momentum of the wheels in telemetry", ("is", "was"), check, _NEXT)


def _warnings(what: str, verbs: tuple[str, str], check: AxesCheck | None, next_step: str) -> tuple[str, ...]:
    """Return the warning of a check, with what to do where an instrument is refused; verbs of now and of then."""
    if check is None or not check.reason:
        return ()
    if check.verdict is MotionVerdict.CONTRADICTED:
        return (f"{what} {verbs[0]} refused: {check.reason}; {next_step}",)
    is_unchecked = check.verdict is MotionVerdict.UNCHECKED
    return (f"{what} {verbs[1]} {'not checked' if is_unchecked else 'checked in part'}: {check.reason}",)


def _too_few(of_what: str, records: int) -> str:
    return f"{records} records {of_what}within the turns, {_LEAST_RECORDS} are needed"


def _verdict(contradiction: str, doubt: str) -> tuple[MotionVerdict, str]:
    """Return the verdict and its reason from what contradicts an instrument and why it cannot be judged."""
    if contradiction:
        return MotionVerdict.CONTRADICTED, contradiction
    return (MotionVerdict.UNCHECKED, doubt) if doubt else (MotionVerdict.CONSISTENT, "")


def _response(
    data: CalibrationInput, records: list[TelemetryRecord], spacecraft: Spacecraft, config: CalibrationConfig
) -> MomentumResponse:
    epochs_us = epochs_of(records)
    yaw, roll, pitch = angle_inertia_kg_m2(spacecraft)
    return momentum_response(
        (epochs_us - epochs_us[0]) / US_PER_S,
        np.array([one.wheel_momentum_n_m_s for one in records]) @ np.array(spacecraft.wheels.axes),
        data.angles_deg(epochs_us, config),
        _is_slewing(data, epochs_us, config),
        np.array([bool(one.thrusters_active) for one in records], dtype=np.bool_),
        np.array([roll, pitch, yaw]),
    )


def _is_slewing(data: CalibrationInput, epochs_us: IntArray, config: CalibrationConfig) -> BoolArray:
    """Return at which epochs (K,) the spacecraft slews; an angle that is not known counts as still."""
    before, after = (data.angles_deg(epochs_us + shift_us, config) for shift_us in (-_HALF_US, _HALF_US))
    return np.asarray((np.abs(after - before) > _SLEW_DEG).any(axis=1))


def _judged(response: MomentumResponse, stated: WheelMomentum, config: CalibrationConfig) -> AxesCheck:
    pitch, bias = float(response.mean_n_m_s[1]), stated.pitch_bias_n_m_s
    contradiction = _contradiction(response, response.deviation(stated.scale_error))
    least_n_m_s = math.inf if bias is None or abs(bias) < _LEAST_N_M_S else config.momentum_bias_share * abs(bias)
    if not contradiction and abs(pitch - (bias or 0.0)) > least_n_m_s:
        contradiction = f"{pitch:.3g} N m s along pitch on average, onboard.momentum.pitch_bias_n_m_s states {bias:g}"
    verdict, reason = _verdict(contradiction, "" if response.is_determined else _why_undetermined(response))
    if verdict is MotionVerdict.CONSISTENT and bias is None:
        reason = (
            "a unit or a sign that all axes share stays unproven; state onboard.momentum.pitch_bias_n_m_s, the "
            f"momentum along pitch that unloadings restore (reported {pitch:.3g} N m s)"
        )
    roll, pitch_scale, yaw = response.coefficient.tolist()
    roll_sigma, pitch_sigma, yaw_sigma = response.sigma.tolist()
    return AxesCheck(verdict, reason, (roll, pitch_scale, yaw), (roll_sigma, pitch_sigma, yaw_sigma))


def _why_undetermined(response: MomentumResponse) -> str:
    """Return why the turns do not tell the response."""
    if response.records < _LEAST_RECORDS:
        several = f", between {response.stretches - 1} unloadings or jumps" if response.stretches > 1 else ""
        return (
            f"{response.records} records with the attitude standing still{several}; {_LEAST_RECORDS} without an "
            "unloading between them are needed: unload before the turns"
        )
    pitch = float(response.mean_n_m_s[1])
    if abs(pitch) < _LEAST_N_M_S:
        return f"{pitch:.2f} N m s along pitch are too little for turns to move; such wheels tell next to nothing"
    roll, _, yaw = response.sigma.tolist()
    return f"turns in yaw and roll tell the response to {roll:.2g} and {yaw:.2g} only, 0.2 is needed"


def _contradiction(response: MomentumResponse, sigmas: float) -> str:
    """Return what contradicts the telemetry, with its figures; empty = nothing."""
    if not sigmas > _SIGMAS:
        return ""
    figures = ", ".join(
        f"{axis} {value:+.2f} +- {sigma:.2f}"
        for axis, value, sigma in zip(("roll", "pitch", "yaw"), response.coefficient, response.sigma, strict=True)
        if math.isfinite(sigma)
    )
    return f"its response to the turns is off by {sigmas:.1f} sigma ({figures}; each must be +1)"


_US_PER_H = 3.6e9
#: of yaw, roll, pitch among roll, pitch, yaw
_NAMED = (1, 2, 0)
_RATES_NEXT = (
    "the filter does not use them under this calibration; correct sign, order of axes, unit or epochs of "
    "body_rate_deg_s, or onboard.rate_sensor, send the records of the turns again and calibrate again"
)
IN_LOOP = (
    "onboard.rate_sensor is in the loop on board: its rates tell nothing new and the filter does not use them; state a "
    "sensor beside the loop to have yaw known better"
)


def rate_check(data: CalibrationInput, config: CalibrationConfig) -> AxesCheck | None:
    """Return the check; None where the catalogue has no rate sensor beside the loop."""
    sensor = rate_sensor_model(data.spacecraft)
    if sensor is None:
        return None
    turns = data.request.turns
    within = (one for one in data.telemetry if turns.start_us <= one.epoch_us < turns.stop_us)
    records = {one.epoch_us: one.body_rate_deg_s for one in within if one.body_rate_deg_s is not None}
    if len(records) < _LEAST_RECORDS:
        return AxesCheck(MotionVerdict.UNCHECKED, _too_few("of rates ", len(records)))
    epochs_us = np.array(sorted(records), dtype=np.int64)
    response = rate_response(
        (epochs_us - epochs_us[0]) / _US_PER_H,
        inertial_deg_h([records[epoch_us] for epoch_us in epochs_us.tolist()]),
        data.angles_deg(epochs_us, config),
    )
    return _judged_rates(response, sensor.bias_deg_h)


def rate_warnings(data: CalibrationInput, check: AxesCheck | None) -> tuple[str, ...]:
    """Return the warnings of a check."""
    if is_rate_in_loop(data.spacecraft):
        return (IN_LOOP,)
    return _warnings("the rates of the body in telemetry", ("are", "were"), check, _RATES_NEXT)


def _judged_rates(response: RateResponse, bias_deg_h: float) -> AxesCheck:
    values, sigma = (part.diagonal()[list(_NAMED)].tolist() for part in (response.coefficient, response.sigma))
    doubt = "rates that stand still, or too few turns: the response of an axis is known worse than to 0.2"
    verdict, reason = _verdict(
        _rates_contradiction(response, response.deviation(bias_deg_h)), "" if response.is_determined else doubt
    )
    return AxesCheck(verdict, reason, (values[0], values[1], values[2]), (sigma[0], sigma[1], sigma[2]))


def _rates_contradiction(response: RateResponse, sigmas: float) -> str:
    """Return what contradicts the telemetry, with its figures; empty = nothing."""
    if not sigmas > _SIGMAS:
        return ""
    axes = ("yaw", "roll", "pitch")
    rows = (
        f"turns about {axis} by " + ", ".join(f"{name} {value:+.2f}" for name, value in zip(axes, row, strict=True))
        for axis, row in zip(axes, response.coefficient.tolist(), strict=True)
    )
    rest = ", ".join(f"{axis} {value:+.2f}" for axis, value in zip(axes, response.rest_deg_h.tolist(), strict=True))
    return (
        f"off by {sigmas:.1f} sigma ({'; '.join(rows)}: each must be +1 by its own rate and 0 by the others; at rest "
        f"{rest} deg/h beside the turn of the orbit, which must be 0)"
    )


#: sigmas from which the catalogue's turn of a feed is contradicted
_FEED_SIGMAS = 5.0
_POLARIMETER_NEXT = (
    "the filter does not use it under this calibration; correct the sign of feed_offset_deg, the feed or the ratio, "
    "send the records of the turns again and calibrate again"
)


def polarimeter_checks(data: CalibrationInput, config: CalibrationConfig) -> tuple[PolarimeterCheck, ...]:
    """Return the check of each polarimeter that the catalogue uses."""
    if data.spacecraft is None:
        return ()
    return tuple(_polarimeter_check(data, config, data.spacecraft, each) for each in used_polarimeters(data.spacecraft))


def polarimeter_quality(checks: tuple[PolarimeterCheck, ...]) -> dict[str, float]:
    """Return the figures of the check that is farthest from a true instrument, by name."""
    known = [check for check in checks if math.isfinite(check.response_sigma)]
    if not known:
        return {}
    worst = max(known, key=lambda check: abs(check.response - 1.0) / check.response_sigma)
    figures = {"polarimeter_response": worst.response, "polarimeter_response_sigma": worst.response_sigma}
    if worst.feed is None:
        return figures
    return figures | {
        "polarimeter_feed_turn_deg": worst.feed.mean[0],
        "polarimeter_feed_turn_sigma_deg": math.sqrt(worst.feed.covariance[0][0]),
        "polarimeter_leakage_deg": worst.feed.leakage_deg,
        "polarimeter_leakage_sigma_deg": worst.feed.leakage_sigma_deg,
        "polarimeter_daily_deg": math.hypot(*worst.feed.mean[1:]),
    }


def polarimeter_warnings(checks: tuple[PolarimeterCheck, ...]) -> tuple[str, ...]:
    """Return the warnings of the checks."""
    texts = {
        MotionVerdict.CONTRADICTED: f"is refused: {{}}; {_POLARIMETER_NEXT}",
        MotionVerdict.UNCHECKED: "was not checked: {}",
        MotionVerdict.CONSISTENT: "is used: {}",
    }
    return tuple(
        f"polarimeter {check.source} {texts[check.verdict].format(check.reason)}" for check in checks if check.reason
    )


def _polarimeter_check(
    data: CalibrationInput, config: CalibrationConfig, spacecraft: Spacecraft, polarimeter: Polarimeter
) -> PolarimeterCheck:
    source, records = polarimeter.source, _polarization(data, polarimeter, data.request.turns)
    if len(records) < _LEAST_RECORDS:
        return PolarimeterCheck(source, MotionVerdict.UNCHECKED, _too_few("", len(records)))
    epochs_us = epochs_of(records)
    measured = np.array([measured_angle_deg(one, polarimeter) for one in records])
    expected = _expected_deg(data, config, spacecraft, polarimeter, epochs_us)
    response = angle_response((epochs_us - epochs_us[0]) / _US_PER_H, measured, expected)
    check = _judged_angle(source, response)
    if check.verdict is MotionVerdict.CONTRADICTED:
        return check
    feed = _feed(data, config, spacecraft, polarimeter, response)
    return replace(check, reason=check.reason or _about_feed(feed, polarimeter.feed_offset_deg), feed=feed)


def _feed(
    data: CalibrationInput,
    config: CalibrationConfig,
    spacecraft: Spacecraft,
    polarimeter: Polarimeter,
    response: AngleResponse,
) -> FeedFit | None:
    """Return what quiet days and turns tell of the feed; None where its records are no ratios or contradict."""
    windows = data.request.quiet, data.request.turns
    records = _polarization(data, polarimeter, *windows)
    if any(one.ratio_db is None or one.feed_offset_deg is not None for one in records):
        return None
    epochs_us = epochs_of(records)
    expected = _expected_deg(data, config, spacecraft, polarimeter, epochs_us)
    left = [
        _less(one, polarimeter, angle_deg)
        for one, angle_deg in zip(records, expected.tolist(), strict=True)
        if math.isfinite(angle_deg)
    ]
    (read,) = polarimeter_models(spacecraft, (polarimeter,))
    learned = feed_turn(every_block(left, polarimeter), read)
    if learned is None:
        return None
    offset_deg, cosine_deg, sine_deg = learned.mean
    turn_deg = polarimeter.feed_offset_deg + offset_deg
    leakage, stop_us = feed_leakage(response, turn_deg), max(window.stop_us for window in windows)
    return FeedFit((turn_deg, cosine_deg, sine_deg), learned.covariance, *leakage, stop_us)


def _less(record: PolarizationRecord, polarimeter: Polarimeter, expected_deg: float) -> PolarizationRecord:
    """Return a ratio as the angle that it is beside an expected one."""
    left_deg, sigma_deg = measured_angle_deg(record, polarimeter) - expected_deg, noise_deg(record, polarimeter)
    return replace(record, ratio_db=None, noise_db=None, tec_tecu=None, angle_deg=left_deg, sigma_deg=sigma_deg)


def _about_feed(feed: FeedFit | None, stated_deg: float) -> str:
    """Return what contradicts the turn of the feed that the catalogue states; empty = nothing."""
    if feed is None:
        return ""
    turn_deg = feed.mean[0] - feed.leakage_deg
    sigma_deg = math.hypot(math.sqrt(feed.covariance[0][0]), feed.leakage_sigma_deg)
    if abs(turn_deg - stated_deg) <= _FEED_SIGMAS * sigma_deg:
        return ""
    return (
        f"its feed is turned by {turn_deg:.1f} +- {sigma_deg:.1f} deg, the catalogue states {stated_deg:g}; the filter "
        "takes what the ratios tell: measure the feed, its gain and its isolation, and correct feed_offset_deg"
    )


def _polarization(data: CalibrationInput, polarimeter: Polarimeter, *windows: Window) -> list[PolarizationRecord]:
    """Return the records of a polarimeter within some windows, in order of epoch."""
    own = (one for one in data.polarization if one.source == polarimeter.source)
    within = (one for one in own if any(window.start_us <= one.epoch_us < window.stop_us for window in windows))
    return sorted(within, key=lambda one: one.epoch_us)


def _expected_deg(
    data: CalibrationInput,
    config: CalibrationConfig,
    spacecraft: Spacecraft,
    polarimeter: Polarimeter,
    epochs_us: IntArray,
) -> FloatArray:
    """Return the angle (K,) about the line of sight by the sensors and the orbit, deg."""
    sight = line_of_sight(spacecraft, polarimeter)
    angles = data.angles_deg(epochs_us, config)
    return np.asarray(angles @ np.array(sight) + orbit_turn_deg(data.ephemeris, spacecraft, sight, epochs_us))


def _judged_angle(source: str, response: AngleResponse) -> PolarimeterCheck:
    sigmas, contradiction = response.deviation(), ""
    if sigmas > _SIGMAS:
        contradiction = (
            f"its angle follows the turns by {response.coefficient:+.2f} +- {response.sigma:.2f}, which must be +1 "
            f"({sigmas:.1f} sigma)"
        )
    doubt = "" if response.is_determined else "too few turns in yaw: the response is known worse than to 0.2"
    return PolarimeterCheck(source, *_verdict(contradiction, doubt), response.coefficient, response.sigma)
