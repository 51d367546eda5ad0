"""Check of the rates at calibration: what is passed, what is refused, and why something was not checked."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_payload import GeometryPayload
from turned_wheels import MINUTE_US, SCENARIO, turned_deg

from service.pipeline.calibration.rate_check import IN_LOOP, rate_check, rate_quality, rate_warnings
from service.pipeline.calibration.windows import CalibrationInput
from service.pipeline.config import CalibrationConfig
from service.records.calibration import CalibrationMethod, CalibrationRequest, MotionVerdict, Window
from service.records.catalogue import BodyRateSensor
from service.records.inputs import TelemetryRecord
from service.records.levels.attitude import Axes
from service.records.levels.series import ReferenceSeries

CONFIG = CalibrationConfig()
STATED = BodyRateSensor(in_loop=False, bias_deg_h=0.01, bias_tau_h=8.0, noise_deg_sqrt_h=0.003)
SEED, W_PER_H = 5, 0.2625162


def data(
    stated: BodyRateSensor | None = STATED, matrix: np.ndarray | None = None, records: int | None = None
) -> CalibrationInput:
    """Return the input of a calibration whose rates are a matrix times the truth, yaw, roll, pitch, deg/s."""
    payload, rng, angles = GeometryPayload.make(16, quiet_days=1.0), np.random.default_rng(SEED), turned_deg()
    turned = np.diff(angles, axis=0) * 60.0
    yaw, roll, pitch = (0.5 * (angles[1:] + angles[:-1])).T
    turned += W_PER_H * np.column_stack([roll, -yaw, 0.0 * pitch]) - np.array([0.0, 0.0, np.rad2deg(W_PER_H)])
    turned += rng.normal(0.0, 0.02, turned.shape)
    epochs_us = SCENARIO.start_us + MINUTE_US * np.arange(len(angles))
    rates = turned @ (np.eye(3) if matrix is None else matrix).T / 3600.0
    telemetry = [
        TelemetryRecord(epoch_us, body_rate_deg_s=Axes(*values))
        for epoch_us, values in zip(epochs_us[1:].tolist(), rates.tolist(), strict=True)
    ]
    start_us, stop_us = int(epochs_us[0]), int(epochs_us[-1]) + MINUTE_US
    request = CalibrationRequest(
        Window(start_us - 3_600_000_000, start_us), Window(start_us, stop_us), CalibrationMethod.GEOMETRY
    )
    seen = angles + rng.normal(0.0, 0.01, angles.shape)
    return replace(
        payload.data(noise_db=0.03),
        request=request,
        references=(ReferenceSeries("star_tracker", epochs_us, seen, np.full(angles.shape, 0.01)),),
        quiet_references=(),
        spacecraft=replace(payload.spacecraft, onboard=replace(payload.spacecraft.onboard, rate_sensor=stated)),
        telemetry=tuple(telemetry[:records]),
    )


def test_nothing_is_checked_where_the_catalogue_states_no_sensor_or_one_in_the_loop() -> None:
    assert rate_check(data(None), CONFIG) is None
    assert rate_quality(None) == {}
    assert rate_warnings(data(None), None) == ()
    looped = data(BodyRateSensor(in_loop=True))
    assert rate_check(looped, CONFIG) is None
    assert rate_warnings(looped, None) == (IN_LOOP,)


def test_true_rates_pass_in_silence_with_their_figures() -> None:
    given = data()
    check = rate_check(given, CONFIG)
    assert check is not None
    assert check.verdict is MotionVerdict.CONSISTENT
    assert rate_warnings(given, check) == ()
    figures = rate_quality(check)
    print(f"seed {SEED}", figures)
    for axis in ("roll", "pitch", "yaw"):
        assert abs(figures[f"rate_response_{axis}"] - 1.0) < 0.05
        assert figures[f"rate_response_{axis}_sigma"] < 0.05


@pytest.mark.parametrize(
    ("name", "matrix"),
    [
        ("sign of yaw", np.diag([-1.0, 1.0, 1.0])),
        ("sign of pitch", np.diag([1.0, 1.0, -1.0])),
        ("roll and yaw exchanged", np.eye(3)[[1, 0, 2]]),
        ("deg/h", 3600.0 * np.eye(3)),
        ("rad/s", np.radians(1.0) * np.eye(3)),
    ],
)
def test_wrong_rates_are_refused_with_figures_and_the_next_step(name: str, matrix: np.ndarray) -> None:
    given = data(matrix=matrix)
    check = rate_check(given, CONFIG)
    assert check is not None, name
    assert check.verdict is MotionVerdict.CONTRADICTED
    (text,) = rate_warnings(given, check)
    assert "sigma (turns about yaw by" in text
    assert "the filter does not use them under this calibration; correct sign, order of axes, unit" in text


@pytest.mark.parametrize(("records", "reason"), [(19, "19 records of rates within the turns, 20 are needed"), (40, "")])
def test_too_few_records_are_not_checked_and_say_why(records: int, reason: str) -> None:
    given = data(records=records)
    check = rate_check(given, CONFIG)
    assert check is not None
    assert check.verdict is MotionVerdict.UNCHECKED
    (text,) = rate_warnings(given, check)
    assert text.startswith("the rates of the body in telemetry were not checked: ")
    assert reason in text
