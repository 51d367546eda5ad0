"""Loop on board on angles of the ground: once each, none that is over or beyond the age limit, and it converges."""

import math

import pytest

from analyzer_sim.epochs import US_PER_S
from analyzer_sim.world.spacecraft.angles_loop import Angles, AnglesLoop
from analyzer_sim.world.spacecraft.wheels import QUANTUM_N_M

INERTIA = (2600.0, 2600.0, 1400.0)
MINUTE_US = 60 * US_PER_S
STILL = (0.0, 0.0, 0.0)


def loop(age_limit_s: float = 600.0) -> AnglesLoop:
    return AnglesLoop(INERTIA, 0.0, age_limit_s)


def reported(counter: int, minute: float, attitude_deg=(0.0, 0.2, 0.0), valid_s: float = 210.0) -> Angles:
    epoch_us = round(minute * MINUTE_US)
    return Angles(counter, epoch_us, epoch_us + round(valid_s * US_PER_S), attitude_deg)


def span(minute: int) -> tuple[int, int]:
    return minute * MINUTE_US, (minute + 1) * MINUTE_US


@pytest.mark.parametrize(("axis", "angle_deg"), [(0, 0.3), (1, 0.2), (1, -0.2), (2, -0.1)])
def test_a_pulse_of_whole_quanta_pushes_against_the_angle(axis, angle_deg):
    one, attitude = loop(), [0.0, 0.0, 0.0]
    attitude[axis] = angle_deg
    one.consume(reported(1, 0, tuple(attitude)), 0)
    (pulse,) = one.command(span(0), STILL)
    torque = pulse.torque_n_m[axis]
    assert math.copysign(1.0, torque) == -math.copysign(1.0, angle_deg)
    assert abs(torque) / QUANTUM_N_M == pytest.approx(round(abs(torque) / QUANTUM_N_M))
    assert [t for k, t in enumerate(pulse.torque_n_m) if k != axis] == [0.0, 0.0]
    assert pulse.start_us == 0
    assert pulse.stop_us <= MINUTE_US


def test_no_angle_is_acted_on_before_the_first_product_and_beyond_the_age_limit():
    one = loop(age_limit_s=600.0)
    assert one.is_holding(0)
    assert one.command(span(0), STILL) == ()
    one.consume(reported(1, 0), 60 * US_PER_S)
    assert one.command(span(10), STILL) != ()
    assert one.is_holding(601 * US_PER_S)
    assert one.command(span(11), STILL) == ()
    # a rate that it knows of is taken away all the same
    (pulse,) = one.command(span(11), (0.0, 0.0, 1e-4))
    assert pulse.torque_n_m[2] < 0.0
    # the next product ends it
    one.consume(reported(2, 11), 11 * MINUTE_US + 30 * US_PER_S)
    assert not one.is_holding(12 * MINUTE_US)
    assert one.command(span(12), STILL) != ()


def test_a_limit_that_is_no_number_holds():
    one = loop(age_limit_s=math.nan)
    one.consume(reported(1, 0), 0)
    assert one.is_holding(0)


@pytest.mark.parametrize(
    ("second", "received_s"),
    [
        (reported(1, 1), 70.0),  # the same counter again
        (reported(0, 1), 70.0),  # an older one that was overtaken
        (reported(2, 1, valid_s=9.0), 70.0),  # over before it came
        (reported(2, -30.0), 70.0),  # of a time that is no longer remembered
    ],
)
def test_a_product_is_taken_once_in_order_and_in_time(second, received_s):
    one = loop()
    one.consume(reported(1, 0), 0)
    one.command(span(0), STILL)
    one.command(span(1), STILL)
    before = (one.newest, list(one.angles_deg), list(one.bias_deg_s))
    one.consume(second, round(received_s * US_PER_S))
    assert (one.newest, one.angles_deg, one.bias_deg_s) == before


def test_a_drift_that_nobody_sees_is_learned_and_held():
    """Roll is carried off by 0.05 deg/h; products come two minutes late. Within 0.05 deg after three hours."""
    one, roll, given = loop(1800.0), 0.2, 0.0
    drift = 0.05 / 3600.0
    queue: list[Angles] = []
    for minute in range(360):
        queue.append(reported(minute + 1, minute, (0.0, roll, 0.0)))
        if len(queue) > 2:
            one.consume(queue.pop(0), minute * MINUTE_US)
        for pulse in one.command(span(minute), (0.0, given, 0.0)):
            seconds = (pulse.stop_us - pulse.start_us) / US_PER_S
            given += math.degrees(pulse.torque_n_m[1] * seconds / INERTIA[1])
        roll += (given + drift) * 60.0
        if minute >= 180:
            assert abs(roll) < 0.05
    assert one.bias_deg_s[1] == pytest.approx(drift, rel=0.1)
