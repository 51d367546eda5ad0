"""Ground of a closed loop: the profile that the plant announces stands in the catalogue, with its errors."""

from dataclasses import replace

import pytest

from service.records.catalogue import AxisTorques, ControlSettings, Release
from service.study.closed_loop.ground_knowledge import AXIS_RELATIVE_ERROR, RELATIVE_ERROR, ground_of
from service.study.closed_loop.plant_process import PlantProcess
from service.study.closed_loop.run import COMMAND_PERIOD_S, LOOP_PERIOD_S, flown_spacecraft


def test_the_ground_states_what_the_plant_announces_and_how_wrong_it_may_be() -> None:
    with PlantProcess("nominal", 1, operation_days=0.01) as plant:
        opening = plant.opening()
    stated = ground_of(opening).spacecraft.onboard.fed_forward_torque
    announced = opening.fed_forward
    assert stated is not None
    assert announced is not None
    assert stated.cosine_n_m == AxisTorques(**announced["cosine_n_m"])
    assert stated.sine_n_m == AxisTorques(**announced["sine_n_m"])
    # of the order of the light of the Sun, 95 % of it
    assert 1.2e-5 < (stated.cosine_n_m.roll**2 + stated.sine_n_m.roll**2) ** 0.5 < 1.3e-5
    assert (stated.relative_error, stated.axis_relative_error) == (RELATIVE_ERROR, AXIS_RELATIVE_ERROR)
    assert ground_of(opening).spacecraft.onboard.residual_torque_n_m == 0.0
    flown = flown_spacecraft(ground_of(opening).spacecraft, Release.TWO_STEP).control
    assert (flown.period_s, flown.command_period_s) == (LOOP_PERIOD_S, COMMAND_PERIOD_S)
    silent = replace(opening, fed_forward=None)
    assert ground_of(silent).spacecraft.onboard.fed_forward_torque is None


@pytest.mark.parametrize("name", ["unknown_residual_constant", "unknown_residual_daily"])
def test_of_a_torque_that_nobody_knows_the_catalogue_has_its_defaults(name: str) -> None:
    with PlantProcess(name, 1, operation_days=0.01) as plant:
        record = ground_of(plant.opening()).spacecraft
    assert (record.onboard.residual_torque_n_m, record.onboard.fed_forward_torque) == (None, None)
    for release in Release:
        control = flown_spacecraft(record, release).control
        assert control == replace(ControlSettings(), release=release, method=record.control.method)
