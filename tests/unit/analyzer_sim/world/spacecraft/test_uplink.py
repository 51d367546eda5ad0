"""Uplink: latency, losses and repetitions as stated, every counter executed once."""

import numpy as np
import pytest

from analyzer_sim.world.spacecraft.rigid_body import TorqueElement
from analyzer_sim.world.spacecraft.uplink import UPLINKS, Arrival, Command, CommandStore, Fate, Uplink
from analyzer_sim.world.spacecraft.wheels import MOMENTUM_LIMIT_N_M_S

S = 1_000_000
STILL = (0.0, 0.0, 0.0)


def command(counter: int, start_s: int = 200, torque: float = 0.004) -> Command:
    return Command(counter, (TorqueElement(start_s * S, (start_s + 5) * S, (0.0, torque, 0.0)),))


def arrivals(seed: int, count: int) -> list[Arrival]:
    uplink = Uplink(UPLINKS["link"], seed)
    for counter in range(count):
        uplink.send(command(counter), 0)
    return uplink.arrivals(10**9)


def test_latency_losses_and_repetitions_are_those_stated():
    count = 20_000
    here = arrivals(1, count)
    seconds = np.array([arrival.received_us for arrival in here]) / S
    counters = [arrival.command.counter for arrival in here]
    lost = 1.0 - len(set(counters)) / count
    repeated = (len(counters) - len(set(counters))) / count
    print(f"seed 1: {lost:.4f} lost, {repeated:.4f} twice, {seconds.min():.1f}..{seconds.max():.1f} s")
    assert 30.0 <= seconds.min() < 31.0
    assert 119.0 < seconds.max() <= 120.0
    assert seconds.mean() == pytest.approx(75.0, abs=0.6)
    # three sigma of so many draws
    assert lost == pytest.approx(0.02, abs=3.0 * (0.02 / count) ** 0.5)
    assert repeated == pytest.approx(0.01 * 0.98, abs=3.0 * (0.01 / count) ** 0.5)
    assert seconds.tolist() == sorted(seconds)


def test_what_becomes_of_a_command_depends_on_its_place_alone():
    few, many = arrivals(3, 40), arrivals(3, 80)
    assert few == [arrival for arrival in many if arrival.command.counter < 40]


def test_an_arrival_is_given_once():
    uplink = Uplink(UPLINKS["ideal"], 1)
    uplink.send(command(1), 5 * S)
    assert uplink.arrivals(5 * S) == []
    assert [arrival.received_us for arrival in uplink.arrivals(6 * S)] == [5 * S]
    assert uplink.arrivals(7 * S) == []


def test_a_counter_is_executed_once_whatever_comes_with_it():
    store = CommandStore()
    assert store.receive(Arrival(40 * S, command(7)), STILL)[0] is None
    for again in (command(7), command(7, 300, -0.004)):
        report, elements = store.receive(Arrival(90 * S, again), STILL)
        assert report is not None
        assert (report.fate, elements) == (Fate.REPEATED, ())
    assert store.ended(204 * S) == []
    (report,) = store.ended(205 * S)
    assert (report.counter, report.fate, report.executed_us) == (7, Fate.EXECUTED, (200 * S, 205 * S))
    assert report.impulse_n_m_s == pytest.approx((0.0, 0.02, 0.0))
    assert store.ended(900 * S) == []


def test_a_newer_command_takes_the_place_of_what_has_not_begun_of_an_older_one():
    store = CommandStore()
    older = Command(1, tuple(element for at_s in (100, 198, 300) for element in command(1, at_s).elements))
    store.receive(Arrival(40 * S, older), STILL)
    (report,) = store.ended(150 * S)
    assert (report.counter, report.fate, report.executed_us) == (1, Fate.EXECUTING, (100 * S, 105 * S))
    # told once
    assert store.ended(160 * S) == []
    store.receive(Arrival(170 * S, command(2)), STILL)
    flown = sorted((element.start_us // S, element.stop_us // S) for element in store.acting(150 * S))
    assert flown == [(198, 200), (200, 205)]
    reports = {report.counter: report for report in store.ended(400 * S)}
    assert [(reports[c].fate, reports[c].executed_us) for c in (1, 2)] == [
        (Fate.EXECUTED, (100 * S, 200 * S)),
        (Fate.EXECUTED, (200 * S, 205 * S)),
    ]
    # 5 s and 2 s of 0.004 N m
    assert reports[1].impulse_n_m_s == pytest.approx((0.0, 0.028, 0.0))


def test_a_command_that_is_overtaken_by_a_newer_one_gives_way_to_it():
    store = CommandStore()
    assert store.receive(Arrival(40 * S, command(8)), STILL)[0] is None
    assert store.receive(Arrival(50 * S, command(7)), STILL) == (None, ())
    assert store.receive(Arrival(60 * S, command(6, 100)), STILL)[1] == command(6, 100).elements
    assert {report.counter: report.fate for report in store.ended(205 * S)} == {
        6: Fate.EXECUTED,
        7: Fate.REPLACED,
        8: Fate.EXECUTED,
    }


def test_a_command_that_comes_too_late_is_left_out_as_a_whole():
    store = CommandStore()
    pair = Command(1, (*command(1, 100).elements, *command(1, 400).elements))
    report, elements = store.receive(Arrival(101 * S, pair), STILL)
    assert report is not None
    assert (report.fate, elements) == (Fate.LATE, ())
    assert store.ended(900 * S) == []


def test_a_command_beyond_the_wheels_is_refused():
    store = CommandStore()
    full = (0.0, MOMENTUM_LIMIT_N_M_S - 0.01, 0.0)
    away, back = command(1, torque=-0.004), command(2, torque=0.004)
    report, _ = store.receive(Arrival(40 * S, away), full)
    assert report is not None
    assert report.fate is Fate.REFUSED
    assert store.receive(Arrival(40 * S, back), full)[0] is None


def test_torques_are_rounded_to_whole_quanta():
    _, elements = CommandStore().receive(Arrival(0, command(1, torque=0.0031)), STILL)
    assert elements[0].torque_n_m == pytest.approx((0.0, 0.004, 0.0))
    _, elements = CommandStore().receive(Arrival(0, command(1, torque=0.0009)), STILL)
    assert elements[0].torque_n_m == STILL
