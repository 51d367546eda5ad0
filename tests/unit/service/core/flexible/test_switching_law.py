"""The table of the pulse law."""

import math

import pytest

from service.core.flexible.switching_law import (
    WATCHES,
    Arm,
    SwitchingLaw,
    arm_after_pulse,
    counter_after,
    require_law,
)

LAW = SwitchingLaw(0.0175, 0.0349, 1.0, 3, 2e-3)


def test_every_state_has_its_row():
    assert set(WATCHES) == set(Arm)
    assert {watch.line for row in WATCHES.values() for watch in row} == {"line", "alpha", "beta", "last"}


@pytest.mark.parametrize(
    ("arm", "lines"),
    [
        (Arm.NEUTRAL, {"line": Arm.FIRING}),
        (Arm.COUNTING, {"line": Arm.FIRING, "alpha": Arm.NEUTRAL}),
        (Arm.FULL, {"line": Arm.FIRING, "last": Arm.CAPPED}),
        (Arm.CAPPED, {"line": Arm.FIRING, "beta": Arm.NEUTRAL}),
        (Arm.FIRING, {}),
        (Arm.RELAY_ON, {"alpha": Arm.NEUTRAL}),
    ],
)
def test_what_is_watched(arm, lines):
    assert {watch.line: watch.to for watch in WATCHES[arm]} == lines


def test_lines_stand_a_step_apart_and_go_on_beyond_the_last():
    assert [LAW.next_line_rad(counter) for counter in range(4)] == pytest.approx([0.0349, 0.0369, 0.0389, 0.0409])
    assert LAW.last_line_rad == pytest.approx(0.0389)


def test_a_single_line_without_a_step_has_none_after_it():
    single = SwitchingLaw(0.0175, 0.0349, 1.0)
    assert single.next_line_rad(0) == 0.0349
    assert math.isinf(single.next_line_rad(1))


def test_counter():
    assert counter_after(Arm.FIRING, 1, LAW) == 2
    assert counter_after(Arm.RELAY_ON, 0, LAW) == 1
    assert counter_after(Arm.CAPPED, 4, LAW) == 2
    assert counter_after(Arm.NEUTRAL, 3, LAW) == 0
    assert counter_after(Arm.FULL, 3, LAW) == 3


@pytest.mark.parametrize(("counter", "arm"), [(1, Arm.COUNTING), (2, Arm.COUNTING), (3, Arm.FULL), (4, Arm.FULL)])
def test_after_a_pulse(counter, arm):
    assert arm_after_pulse(counter, LAW) is arm


@pytest.mark.parametrize(
    ("changes", "reported"),
    [
        ({"alpha_rad": 0.04}, "alpha_rad 0.04 is not at or below beta_rad 0.0349"),
        ({"alpha_rad": 0.0}, "alpha_rad is 0"),
        ({"beta_rad": math.inf}, "not at or below beta_rad inf"),
        ({"pulse_s": 0.0}, "pulse_s is 0, it must be above 0"),
        ({"pulse_s": math.nan}, "pulse_s is nan"),
        ({"pulse_count": 0}, "pulse_count is 0, it must be 1 or more"),
        ({"line_step_rad": 0.0}, "line_step_rad is 0"),
        ({"line_step_rad": -1e-3}, "line_step_rad is -0.001"),
    ],
)
def test_a_law_that_cannot_switch_is_refused(changes, reported):
    with pytest.raises(ValueError, match=reported):
        require_law(LAW._replace(**changes))


def test_one_line_for_on_and_off_is_a_law():
    require_law(LAW._replace(alpha_rad=0.0349))
    assert LAW._replace(pulse_s=math.inf).is_relay
