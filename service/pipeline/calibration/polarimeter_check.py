"""Check of polarimeters by the calibration turns, before the filter uses them.

The law of this file: an instrument is refused only where the turns contradict it; what was not checked is said with
its reason.
"""

import math
from dataclasses import replace

import numpy as np

from service.core.estimation.calibration.checks.responses import AngleResponse, angle_response, feed_leakage, feed_turn
from service.pipeline.calibration.geometry_rows import CalibrationInput
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.polarization import (
    every_block,
    line_of_sight,
    measured_angle_deg,
    noise_deg,
    orbit_turn_deg,
    polarimeter_models,
    used_polarimeters,
)
from service.pipeline.inputs.sensor_angles import angles_at
from service.records.calibration import FeedFit, MotionVerdict, PolarimeterCheck, Window
from service.records.catalogue import Polarimeter, Spacecraft
from service.records.inputs import PolarizationRecord
from service.records.levels.attitude import FloatArray, IntArray

#: sigmas from which an instrument is contradicted
_SIGMAS = 3.5
#: sigmas from which the catalogue's turn of a feed is contradicted
_FEED_SIGMAS = 5.0
_LEAST_RECORDS = 20
_US_PER_H = 3.6e9
_NEXT = (
    "the filter does not use it under this calibration; correct the sign of feed_offset_deg, the feed or the ratio, "
    "send the records of the turns again and calibrate again"
)


def polarimeter_checks(data: CalibrationInput, config: CalibrationConfig) -> tuple[PolarimeterCheck, ...]:
    """Return the check of each polarimeter that the catalogue uses."""
    if data.spacecraft is None:
        return ()
    return tuple(_check(data, config, data.spacecraft, each) for each in used_polarimeters(data.spacecraft))


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
        MotionVerdict.CONTRADICTED: f"is refused: {{}}; {_NEXT}",
        MotionVerdict.UNCHECKED: "was not checked: {}",
        MotionVerdict.CONSISTENT: "is used: {}",
    }
    return tuple(
        f"polarimeter {check.source} {texts[check.verdict].format(check.reason)}" for check in checks if check.reason
    )


def _check(
    data: CalibrationInput, config: CalibrationConfig, spacecraft: Spacecraft, polarimeter: Polarimeter
) -> PolarimeterCheck:
    """Return the check of one polarimeter."""
    source, records = polarimeter.source, _records(data, polarimeter, data.request.turns)
    if len(records) < _LEAST_RECORDS:
        reason = f"{len(records)} records within the turns, {_LEAST_RECORDS} are needed"
        return PolarimeterCheck(source, MotionVerdict.UNCHECKED, reason)
    epochs_us = np.array([one.epoch_us for one in records], dtype=np.int64)
    measured = np.array([measured_angle_deg(one, polarimeter) for one in records])
    expected = _expected_deg(data, config, spacecraft, polarimeter, epochs_us)
    response = angle_response((epochs_us - epochs_us[0]) / _US_PER_H, measured, expected)
    check = _judged(source, response)
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
    records = _records(data, polarimeter, *windows)
    if any(one.ratio_db is None or one.feed_offset_deg is not None for one in records):
        return None
    epochs_us = np.array([one.epoch_us for one in records], dtype=np.int64)
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


def _records(data: CalibrationInput, polarimeter: Polarimeter, *windows: Window) -> list[PolarizationRecord]:
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
    angles = angles_at(epochs_us, data.quiet_references + data.references, data.sensors, config)
    return np.asarray(angles @ np.array(sight) + orbit_turn_deg(data.ephemeris, spacecraft, sight, epochs_us))


def _judged(source: str, response: AngleResponse) -> PolarimeterCheck:
    """Return what the response says of a polarimeter."""
    figures, sigmas = (response.coefficient, response.sigma), response.deviation()
    if sigmas > _SIGMAS:
        reason = (
            f"its angle follows the turns by {response.coefficient:+.2f} +- {response.sigma:.2f}, which must be +1 "
            f"({sigmas:.1f} sigma)"
        )
        return PolarimeterCheck(source, MotionVerdict.CONTRADICTED, reason, *figures)
    if not response.is_determined:
        reason = "too few turns in yaw: the response is known worse than to 0.2"
        return PolarimeterCheck(source, MotionVerdict.UNCHECKED, reason, *figures)
    return PolarimeterCheck(source, MotionVerdict.CONSISTENT, "", *figures)
