"""Ground of a closed loop: the profile that the plant announces stands in the catalogue, with its errors."""

from dataclasses import replace

from service.records.catalogue import AxisTorques
from service.study.closed_loop.ground_knowledge import AXIS_RELATIVE_ERROR, RELATIVE_ERROR, ground_of
from service.study.closed_loop.plant_process import PlantProcess
from service.study.closed_loop.run import RESIDUAL_TORQUE_N_M


def test_the_ground_states_what_the_plant_announces_and_how_wrong_it_may_be() -> None:
    with PlantProcess("nominal", 1, operation_days=0.01) as plant:
        opening = plant.opening()
    told = ground_of(opening).spacecraft.onboard.fed_forward_torque
    announced = opening.fed_forward
    assert told is not None
    assert announced is not None
    assert told.cosine_n_m == AxisTorques(**announced["cosine_n_m"])
    assert told.sine_n_m == AxisTorques(**announced["sine_n_m"])
    # of the order of the light of the Sun, 95 % of it
    assert 1.2e-5 < (told.cosine_n_m.roll**2 + told.sine_n_m.roll**2) ** 0.5 < 1.3e-5
    assert (told.relative_error, told.axis_relative_error) == (RELATIVE_ERROR, AXIS_RELATIVE_ERROR)
    assert RESIDUAL_TORQUE_N_M == 0.0
    silent = replace(opening, fed_forward=None)
    assert ground_of(silent).spacecraft.onboard.fed_forward_torque is None
