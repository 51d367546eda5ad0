"""Check of the momentum at calibration: what is passed, what is refused, and why something was not checked."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from geometry_payload import GeometryPayload
from turned_wheels import ALIKE, WRONG, turned_wheels

from analyzer_sim.world.scenario.story import WheelTelemetry
from service.pipeline.calibration.momentum_check import momentum_check, momentum_quality, momentum_warnings
from service.pipeline.calibration.windows import CalibrationInput
from service.pipeline.config import CalibrationConfig
from service.records.calibration import CalibrationMethod, CalibrationRequest, MotionVerdict, Window
from service.records.catalogue import WheelMomentum
from service.records.inputs import TelemetryRecord
from service.records.levels.series import ReferenceSeries

CONFIG = CalibrationConfig()
STATED = WheelMomentum(pitch_bias_n_m_s=-8.0)
MINUTE_US = 60_000_000


def data(
    seed: int = 1, *, stated: WheelMomentum | None = STATED, start_h: float = 1.0, every: int = 1, **changes: Any
) -> CalibrationInput:
    """Return the input of a calibration whose sensors and wheels are those of one seed."""
    payload = GeometryPayload.make(16, quiet_days=1.0)
    turned = turned_wheels(seed, changes.pop("figures", None), start_h=start_h)
    matrix = changes.pop("matrix", np.eye(3))
    start_us, stop_us = int(turned.epochs_us[0]), int(turned.epochs_us[-1]) + MINUTE_US
    window = Window(start_us, stop_us)
    request = CalibrationRequest(Window(start_us - 3_600_000_000, start_us), window, CalibrationMethod.GEOMETRY)
    sigma = np.full(turned.attitude_deg.shape, 0.01)
    references = ReferenceSeries("star_tracker", turned.epochs_us, turned.attitude_deg, sigma)
    onboard = replace(payload.spacecraft.onboard, momentum=stated)
    told = zip(turned.epochs_us.tolist(), (turned.momentum @ matrix.T).tolist(), strict=True)
    unloaded = changes.pop("unloaded", lambda minute: False)
    telemetry = tuple(
        TelemetryRecord(at_us, None, tuple(values), thrusters_active=unloaded((at_us - start_us) / MINUTE_US))
        for at_us, values in told
    )
    made = payload.data(noise_db=0.03)
    return replace(
        made,
        request=request,
        references=(references,),
        quiet_references=(),
        spacecraft=replace(payload.spacecraft, onboard=onboard),
        telemetry=telemetry[::every],
    )


def test_nothing_is_checked_where_the_catalogue_states_nothing() -> None:
    assert momentum_check(data(stated=None), CONFIG) is None
    assert momentum_quality(None) == {}
    assert momentum_warnings(None) == ()


def test_true_telemetry_passes_in_silence_with_its_figures() -> None:
    check = momentum_check(data(), CONFIG)
    assert check is not None
    assert check.verdict is MotionVerdict.CONSISTENT
    assert momentum_warnings(check) == ()
    figures = momentum_quality(check)
    assert abs(figures["momentum_response_roll"] - 1.0) < 4.0 * figures["momentum_response_roll_sigma"]
    assert figures["momentum_response_yaw_sigma"] < 0.1


@pytest.mark.parametrize("name", [*WRONG, *ALIKE])
@pytest.mark.parametrize("seed", [2, 3, 4])
def test_wrong_telemetry_is_refused_with_the_next_step(name: str, seed: int) -> None:
    matrix = WRONG[name] if name in WRONG else ALIKE[name] * np.eye(3)
    check = momentum_check(data(seed, matrix=matrix), CONFIG)
    assert check is not None
    assert check.verdict is MotionVerdict.CONTRADICTED
    (text,) = momentum_warnings(check)
    assert "the filter does not use it under this calibration; correct sign, order of axes, unit" in text


def test_what_all_axes_share_stays_open_without_a_stated_bias() -> None:
    check = momentum_check(data(matrix=0.7376 * np.eye(3), stated=WheelMomentum()), CONFIG)
    assert check is not None
    assert check.verdict is MotionVerdict.CONSISTENT
    assert "state onboard.momentum.pitch_bias_n_m_s" in momentum_warnings(check)[0]


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"every": 12}, "9 records of momentum within the turns, 20 are needed"),
        ({"figures": WheelTelemetry(bias_n_m_s=0.0), "stated": WheelMomentum(pitch_bias_n_m_s=0.0)}, "N m s along pit"),
        ({"start_h": 7.0, "unloaded": lambda minute: minute % 60.0 == 0.0}, "unload before the turns"),
    ],
)
def test_what_was_not_checked_is_said_with_its_reason(changes: dict[str, Any], reason: str) -> None:
    check = momentum_check(data(**changes), CONFIG)
    assert check is not None
    assert check.verdict is MotionVerdict.UNCHECKED
    (text,) = momentum_warnings(check)
    assert text.startswith("the momentum of the wheels in telemetry was not checked: ")
    assert reason in text
