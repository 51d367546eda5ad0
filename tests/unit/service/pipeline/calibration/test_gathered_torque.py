"""Torque that gathers in the wheels, in a calibration: what is learned, figures, warnings."""

from dataclasses import replace

import numpy as np
import pytest
from driven_world import shared_world

from service.pipeline.calibration.gathered_torque import (
    gathered_quality,
    gathered_torque,
    gathered_warnings,
)
from service.pipeline.calibration.momentum_check import momentum_check
from service.pipeline.calibration.windows import CalibrationInput
from service.pipeline.config import CalibrationConfig
from service.records.calibration import AxesCheck, GatheredTorque, MotionVerdict, Window
from service.records.catalogue import AxisTorques, FedForwardTorque
from service.records.inputs import TelemetryRecord

CONFIG, SENSOR = CalibrationConfig(), np.full(3, 0.01)
GOOD = AxesCheck(MotionVerdict.CONSISTENT, "")
SEED = 1


@pytest.fixture(scope="module")
def told() -> CalibrationInput:
    """Return the input of a simulated calibration with wheels."""
    world = shared_world("wheels", SEED, 0.5)
    ground, documents = world.ground, world.documents
    calibration = documents.calibrations[1]
    quiet, turns = ground.phases["quiet"], ground.phases["turns"]
    return CalibrationInput(
        calibration.request,
        documents.plans[1],
        documents.ephemerides[1],
        ground.series(quiet, documents.plans[1].carrier_ids),
        ground.series(turns, documents.plans[1].carrier_ids),
        ground.references_in(turns),
        ground.references_in(quiet),
        ground.spacecraft,
        telemetry=tuple(e.content for e in ground.events if isinstance(e.content, TelemetryRecord)),
    )


def learned(data: CalibrationInput, check: AxesCheck | None = GOOD) -> GatheredTorque | None:
    return gathered_torque(data, check, SENSOR, CONFIG)


def test_quiet_days_tell_the_torque_and_its_figures(told: CalibrationInput) -> None:
    found = learned(told, momentum_check(told, CONFIG))
    assert found is not None
    figures = gathered_quality(found)
    print(f"seed {SEED}: {figures}")
    assert found.stop_us == told.request.quiet.stop_us
    # records each 5 min of three days; waves of 1e-5 N m are the simulator's, and a constant torque is known by the
    # misalignment of 0.05 deg alone
    assert figures["gathered_torque_records"] == 864.0
    for name in ("yaw", "roll", "pitch"):
        assert abs(figures[f"gathered_daily_{name}_n_m"] - 1e-5) < 4e-7
        assert figures[f"gathered_{name}_sigma_n_m"] < 6e-7
    assert gathered_warnings(told, GOOD, found) == ()


def test_nothing_is_learned_without_momentum_or_of_telemetry_that_turns_contradict(told: CalibrationInput) -> None:
    assert learned(told, None) is None
    assert learned(told, AxesCheck(MotionVerdict.CONTRADICTED, "wrong")) is None
    assert gathered_warnings(told, AxesCheck(MotionVerdict.CONTRADICTED, "wrong"), None) == ()
    assert gathered_quality(None) == {}


def test_too_few_records_are_told_with_their_number(told: CalibrationInput) -> None:
    quiet = told.request.quiet
    short = replace(
        told, request=replace(told.request, quiet=Window(quiet.start_us, quiet.start_us + 3 * 3_600_000_000))
    )
    assert learned(short) is None
    (text,) = gathered_warnings(short, GOOD, None)
    assert "36 records of momentum within the quiet days, 50 are needed" in text
    assert "onboard.momentum.torque" in text


def test_days_without_angles_are_told(told: CalibrationInput) -> None:
    blind = replace(told, quiet_references=())
    assert learned(blind) is None
    (text,) = gathered_warnings(blind, GOOD, None)
    assert "no sensor tells the angles" in text


def test_a_stated_torque_of_the_wrong_sign_is_told(told: CalibrationInput) -> None:
    spacecraft = told.spacecraft
    assert spacecraft is not None
    momentum = spacecraft.onboard.momentum
    assert momentum is not None
    assert momentum.torque is not None
    turned = {
        name: AxisTorques(*(-getattr(getattr(momentum.torque, name), axis) for axis in ("yaw", "roll", "pitch")))
        for name in ("constant_n_m", "cosine_n_m", "sine_n_m")
    }
    wrong = replace(momentum, torque=replace(momentum.torque, **turned))
    data = replace(told, spacecraft=replace(spacecraft, onboard=replace(spacecraft.onboard, momentum=wrong)))
    found = learned(data)
    assert found == learned(told)
    (text,) = gathered_warnings(data, GOOD, found)
    assert "differs from onboard.momentum.torque by" in text


def test_nothing_is_said_where_the_torque_is_fed_forward(told: CalibrationInput) -> None:
    spacecraft = told.spacecraft
    assert spacecraft is not None
    onboard = replace(spacecraft.onboard, fed_forward_torque=FedForwardTorque(epoch_us=0))
    data = replace(told, spacecraft=replace(spacecraft, onboard=onboard))
    assert gathered_warnings(data, GOOD, None) == ()
