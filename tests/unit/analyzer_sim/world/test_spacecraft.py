"""The spacecraft of a story: attitude, stored momentum, uplink, measured motion."""

import itertools
from dataclasses import asdict, replace
from functools import cache

import numpy as np
import pytest

from analyzer_sim.world.motion_statistics import motion_statistics
from analyzer_sim.world.scenario.events import Hold, chunk_edges, holds_of, planned_deg
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.scenario.story import TIMETABLE, TURNS_H, KeepingErrors, Scenario, WheelTelemetry
from analyzer_sim.world.spacecraft.body import INERTIA_KG_M2, MOMENTUM_LIMIT_N_M_S, TorqueElement
from analyzer_sim.world.spacecraft.spacecraft import (
    ORBITAL_RATE_PER_H,
    AttitudeHistory,
    attitude_history,
    coupling_step,
)
from analyzer_sim.world.spacecraft.telemetry import (
    QUANTUM_N_M_S,
    UNLOADED_SHARE,
    gathered_profile,
    reported_momentum,
    unloaded,
    unloadings_us,
)
from analyzer_sim.world.spacecraft.uplink import UPLINKS, Arrival, Command, CommandStore, Fate, Uplink
from analyzer_sim.world.world import World

QUIET = Scenario("short", "for tests", quiet_h=2.0, alignment_h=0.75, operation_h=12.0)
#: nothing that the ground does not know
KNOWN = KeepingErrors(drift_deg_h=(0.0, 0.0, 0.0), scale_error=0.0)
HOLD = Hold(1.0, 3.0, 20.0, yaw_deg=0.3, roll_deg=-0.2, pitch_deg=0.25)


def epochs_of(scenario: Scenario) -> np.ndarray:
    return np.arange(scenario.start_us, scenario.phases[-1].stop_us, scenario.row_period_us, dtype=np.int64)


@cache
def flown(scenario: Scenario, seed: int = 1) -> AttitudeHistory:
    return attitude_history(scenario, seed, epochs_of(scenario))


def integrated_deg(scenario: Scenario, history: AttitudeHistory) -> np.ndarray:
    """Integrate coupling and announced corrections from the last tracked attitude, in steps of six seconds."""
    epochs = epochs_of(scenario)
    first = int(np.searchsorted(epochs, scenario.operation_start_us))
    state = history.attitude_deg[first].copy()
    states = [state.copy()]
    substeps = 10
    step_h = scenario.row_period_s / 3600.0 / substeps
    rate = ORBITAL_RATE_PER_H if scenario.keeping.is_coupled else 0.0
    for epoch_us in epochs[first:-1]:
        correction = next(c for c in history.corrections if c.start_us <= epoch_us < c.stop_us)
        command = np.array(correction.attitude_deg) / ((correction.stop_us - correction.start_us) / 3.6e9)
        for _ in range(substeps):
            middle = state + 0.5 * step_h * (command + rate * np.array([-state[1], state[0], 0.0]))
            state = state + step_h * (command + rate * np.array([-middle[1], middle[0], 0.0]))
        states.append(state.copy())
    return np.array(states)


@pytest.mark.parametrize("is_coupled", [True, False])
def test_corrections_and_coupling_integrate_to_the_truth_without_drift(is_coupled: bool) -> None:
    scenario = replace(QUIET, keeping=replace(KNOWN, is_coupled=is_coupled), manoeuvres=(HOLD,))
    history = flown(scenario)
    expected = integrated_deg(scenario, history)
    first = len(history.attitude_deg) - len(expected)
    # corrections are told to 1e-7 deg each, some 40 of them; the step of six seconds adds less
    np.testing.assert_allclose(history.attitude_deg[first:], expected, atol=5e-6)


def test_drift_makes_the_truth_leave_what_the_ground_can_integrate() -> None:
    scenario = replace(QUIET, keeping=KeepingErrors(), operation_h=24.0)
    history = flown(scenario)
    expected = integrated_deg(scenario, history)
    error = history.attitude_deg[-len(expected) :] - expected
    assert np.all(np.sqrt(np.mean(error**2, axis=0)) > 0.03)  # deg; corrections alone must not do


def test_coupling_turns_yaw_into_roll_and_roll_into_minus_yaw() -> None:
    phi, gamma = coupling_step(1.0, is_coupled=True)
    angle = ORBITAL_RATE_PER_H
    # a quarter degree an hour per degree, exact rotation
    np.testing.assert_allclose(phi @ [1.0, 0.0, 0.0], [np.cos(angle), np.sin(angle), 0.0], atol=1e-15)
    # constant roll rate: yaw = -w t^2 / 2 to second order
    assert (gamma @ [0.0, 1.0, 0.0])[0] == pytest.approx(-angle / 2.0, rel=0.01)
    np.testing.assert_allclose(coupling_step(2.0, is_coupled=False)[1], 2.0 * np.eye(3), atol=1e-15)


@pytest.mark.parametrize("seed", range(5))
def test_demo_moves_widely_and_stays_in_bounds(seed: int) -> None:
    scenario = replace(scenario_named("demo"), quiet_h=1.0)
    attitude = flown(scenario, seed).attitude_deg[epochs_of(scenario) >= scenario.operation_start_us]
    rms, largest = np.sqrt(np.mean(attitude**2, axis=0)), np.abs(attitude).max(axis=0)
    print(f"seed {seed}: rms {rms.round(3)} max {largest.round(3)}")
    assert np.all(rms >= 0.12)  # deg, asked of the demonstration on every axis
    assert np.all(largest <= 0.42)


def test_demo_visits_all_octants() -> None:
    scenario = replace(scenario_named("demo"), quiet_h=1.0)
    attitude = flown(scenario).attitude_deg[epochs_of(scenario) >= scenario.operation_start_us]
    large = attitude[np.all(np.abs(attitude) > 0.15, axis=1)]
    assert len({tuple(row) for row in np.sign(large).tolist()}) == 8


def test_the_tracker_holds_the_quiet_craft_within_a_tenth_of_a_degree() -> None:
    scenario = replace(QUIET, quiet_h=72.0)
    quiet = flown(scenario).attitude_deg[epochs_of(scenario) < scenario.phases[1].start_us]
    assert np.abs(quiet).max() <= 0.1
    assert np.all(quiet.std(axis=0) > 0.01)  # it lives


def test_the_craft_follows_the_timetable_of_the_turns() -> None:
    attitude = flown(QUIET).attitude_deg
    minutes = (epochs_of(QUIET) - QUIET.phases[1].start_us) / 6e7
    for turn in TIMETABLE:
        rows = (minutes >= turn.start_min + 3) & (minutes < turn.stop_min)
        assert np.abs(attitude[rows] - turn.attitude_deg).max() < 0.1  # the limit cycle's bound


def test_the_timetable_lasts_eight_and_a_half_hours() -> None:
    assert pytest.approx(8.5) == TURNS_H  # hours, from the method's recommendation
    turned = {turn.attitude_deg for turn in TIMETABLE if any(turn.attitude_deg)}
    assert len(turned) == 24 + 8


def test_the_attitude_does_not_jump_when_the_tracker_goes_off() -> None:
    attitude = flown(QUIET).attitude_deg
    first = int(np.searchsorted(epochs_of(QUIET), QUIET.operation_start_us))
    # a row of the tracked limit cycle moves by some 0.003 deg, one sigma
    assert np.abs(attitude[first] - attitude[first - 1]).max() < 0.02


def test_corrections_cover_operation_without_overlap() -> None:
    corrections = flown(replace(QUIET, manoeuvres=(HOLD,))).corrections
    assert corrections[0].start_us == QUIET.operation_start_us
    assert corrections[-1].stop_us == QUIET.phases[-1].stop_us
    assert all(a.stop_us == b.start_us for a, b in itertools.pairwise(corrections))


def test_an_unannounced_hold_turns_the_craft_and_tells_nobody() -> None:
    figures = replace(KNOWN, knowledge_deg=(0.0, 0.0, 0.0))
    secret = Hold(1.0, 6.0, 20.0, yaw_deg=0.4, is_announced=False)
    history = flown(replace(QUIET, keeping=figures, manoeuvres=(secret,)))
    rows = epochs_of(QUIET) >= QUIET.operation_start_us + 3 * 3_600_000_000
    assert history.attitude_deg[rows][:120, 0].mean() == pytest.approx(
        0.4, abs=0.03
    )  # decay of the start, one loop time
    reported = np.array(
        [c.attitude_deg for c in history.corrections if c.start_us > QUIET.operation_start_us + 2 * 3.6e9]
    )
    assert np.abs(reported).max() < 0.03  # feedback on that decay only


def test_plan_ramps_and_holds() -> None:
    plan = planned_deg([HOLD], np.array([0.9, 1.0 + 1.0 / 6.0, 2.0, 4.5]))
    # before, half way up the cosine, at full, after
    np.testing.assert_allclose(plan[:, 0], [0.0, 0.15, 0.3, 0.0], atol=1e-12)


def test_pieces_are_short_in_slews_and_reach_the_end() -> None:
    edges = chunk_edges([HOLD], 720, 60.0)
    assert edges[0] == 0
    assert edges[-1] == 720
    assert np.diff(edges[(edges >= 60) & (edges <= 80)]).max() <= 5  # rows of a minute
    assert np.diff(edges).max() <= 30


def test_a_tour_is_the_same_for_the_same_seed_and_fits_the_phase() -> None:
    tour = scenario_named("demo").manoeuvres
    holds = holds_of(tour, 1, 48.0)
    assert holds == holds_of(tour, 1, 48.0)
    assert holds != holds_of(tour, 2, 48.0)
    assert holds[-1].start_h + holds[-1].hold_h + holds[-1].slew_min / 60.0 <= 48.0


@pytest.mark.parametrize(
    ("name", "share"),
    [
        ("corrections_flipped", -1.0),
        ("corrections_halved", 0.5),
        ("corrections_lost", 0.0),
        ("corrections_doubled", 2.0),
    ],
)
def test_false_reports_tell_the_whole_slew_and_the_craft_does_its_share(name: str, share: float) -> None:
    scenario, honest = replace(scenario_named(name), quiet_h=1.0), replace(scenario_named("nominal"), quiet_h=1.0)
    begin_us = scenario.operation_start_us + 9 * 3_600_000_000
    end_us = begin_us + 2 * 3_600_000_000
    rows = [int(np.searchsorted(epochs_of(scenario), epoch)) for epoch in (begin_us, end_us)]
    done = np.diff(flown(scenario).attitude_deg[rows] - flown(honest).attitude_deg[rows], axis=0)[0]
    reported = np.sum(
        [c.attitude_deg for c in flown(scenario).corrections if begin_us <= c.start_us < end_us], axis=0
    ) - np.sum([c.attitude_deg for c in flown(honest).corrections if begin_us <= c.start_us < end_us], axis=0)
    print(f"{name}: told {reported.round(3)} done {done.round(3)} deg")
    # both worlds feed back what they know of their own attitude at other instants: a tenth of a degree of yaw
    np.testing.assert_allclose(np.abs(reported), 0.15, atol=0.09)
    np.testing.assert_allclose(done, share * 0.15 * np.sign(reported), atol=0.09)


def test_false_reports_end_with_an_honest_slew_back() -> None:
    scenario, honest = replace(scenario_named("corrections_doubled"), quiet_h=1.0), replace(QUIET, operation_h=48.0)
    late = epochs_of(scenario) >= scenario.operation_start_us + 22 * 3_600_000_000
    quiet = flown(scenario).attitude_deg[late][: 7 * 60]
    assert np.abs(quiet).max() < 0.35  # no 0.3 deg of an unfinished hold remain on any axis together
    assert np.sqrt(np.mean(quiet**2)) < 0.15
    assert honest.operation_h == scenario.operation_h


def test_a_hidden_yaw_with_told_balance_keeps_roll_and_yaw_in_step() -> None:
    figures = replace(KNOWN, knowledge_deg=(0.0, 0.0, 0.0))
    secret = Hold(1.0, 6.0, 20.0, yaw_deg=0.4, is_announced=False, is_balance_announced=True)
    scenario = replace(QUIET, keeping=figures, manoeuvres=(secret,))
    history = flown(scenario)
    between = [
        c.attitude_deg for c in history.corrections if 3 * 3.6e9 <= c.start_us - scenario.operation_start_us < 6 * 3.6e9
    ]
    # three hours of roll against the exchange: 0.2625 /h times 0.4 deg
    assert np.sum(between, axis=0)[1] == pytest.approx(-3.0 * ORBITAL_RATE_PER_H * 0.4, abs=0.02)
    assert abs(np.sum(between, axis=0)[0]) < 0.03  # the turn itself is told to nobody


def test_init_bias_aligns_off_zero_with_drawn_signs() -> None:
    signs = set()
    for seed in range(6):
        scenario = replace(scenario_named("init_bias"), quiet_h=1.0, operation_h=1.0)
        phase = scenario.phase("alignment")
        epochs = epochs_of(scenario)
        held = flown(scenario, seed).attitude_deg[(epochs >= phase.start_us) & (epochs < phase.stop_us)]
        np.testing.assert_allclose(np.abs(held.mean(axis=0)), [0.25, 0.16, 0.13], atol=0.06)  # a limit cycle around it
        signs.add(tuple(np.sign(held.mean(axis=0)).tolist()))
    assert len(signs) > 2


def test_a_story_without_a_pause_has_no_such_phase() -> None:
    with pytest.raises(KeyError, match="pause"):
        QUIET.phase("pause")


S = 1_000_000
EXACT = WheelTelemetry(
    noise_n_m_s=0.0, misalignment_deg=0.0, scale_error=0.0, torque_n_m=0.0, unknown_n_m=0.0, half_day_share=0.0
)


def reported_of(figures: WheelTelemetry, attitude_deg: np.ndarray, seed: int = 1) -> np.ndarray:
    story = replace(scenario_named("wheels"), wheels=figures)
    epochs_us = story.start_us + 60 * S * np.arange(len(attitude_deg), dtype=np.int64)
    return reported_momentum(story, figures, seed, INERTIA_KG_M2, epochs_us, attitude_deg)


def test_a_yaw_turn_turns_the_pitch_momentum_into_roll() -> None:
    still, turned = np.zeros((30, 3)), np.zeros((30, 3))
    turned[:, 0] = 0.5
    change = reported_of(EXACT, turned)[5] - reported_of(EXACT, still)[5]
    # 8.1 N m s along minus pitch and what the body itself turns with the orbit, 0.5 deg
    assert change[0] == pytest.approx(np.radians(0.5) * (-8.0 + 7.292e-5 * 2600.0), abs=1.5 * QUANTUM_N_M_S)
    assert change[1] == pytest.approx(0.0, abs=1.5 * QUANTUM_N_M_S)


def test_without_a_torque_momentum_stands_still_in_inertial_space() -> None:
    reported = reported_of(EXACT, np.zeros((360, 3)))
    across = reported[:, 0] + 1j * reported[:, 2]
    turned = across[0] * np.exp(-1j * 7.292115e-5 * 60.0 * np.arange(360))
    np.testing.assert_allclose(across, turned, atol=1.5 * QUANTUM_N_M_S)


def test_a_constant_torque_gathers_along_pitch_until_it_is_unloaded() -> None:
    figures = WheelTelemetry(
        noise_n_m_s=0.0, misalignment_deg=0.0, scale_error=0.0, unknown_n_m=0.0, half_day_share=0.0
    )
    reported = reported_of(figures, np.zeros((13 * 60, 3)))[:, 1]
    profile = gathered_profile(figures, 1)
    angle = 2.0 * np.pi / 24.0 * np.arange(660) / 60.0
    torque = profile.constant_n_m[1] + profile.cosine_n_m[1] * np.cos(angle) + profile.sine_n_m[1] * np.sin(angle)
    np.testing.assert_allclose(np.diff(reported[[0, 659]]), 60.0 * torque.sum(), atol=0.01)
    assert reported[12 * 60 + 1] == pytest.approx(-8.0 + 1400.0 * 7.292e-5, abs=0.02)


def short(name: str) -> Scenario:
    return replace(scenario_named(name), quiet_h=12.0, operation_h=3.0)


def test_wheels_of_its_own_change_nothing_else_in_a_world() -> None:
    wheels, plain = World(short("wheels"), 3), World(replace(short("wheels"), wheels=None), 3)
    np.testing.assert_array_equal(wheels.rows.power_dbm, plain.rows.power_dbm)
    np.testing.assert_array_equal(wheels.rows.attitude_deg, plain.rows.attitude_deg)
    assert plain.telemetry == World(short("nominal"), 3).telemetry
    assert len(wheels.telemetry) == pytest.approx(12 * len(plain.telemetry), abs=12)


def test_unloadings_are_marked_where_the_story_says_so() -> None:
    marked, unmarked = World(short("wheels"), 1).telemetry, World(short("wheels_unmarked"), 1).telemetry
    active_us = [record.reported_us for record in marked if record.thrusters_active]
    assert active_us == unloadings_us(short("wheels")).tolist()
    assert not any(record.thrusters_active for record in unmarked)
    reported = [record.wheel_momentum_n_m_s for record in marked]
    assert reported == [record.wheel_momentum_n_m_s for record in unmarked]


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


def stated(name):
    world = World(scenario_named(name, quiet_days=0.5, operation_days=0.1), 1)
    return world, motion_statistics(world)


def test_a_story_without_measured_motion_has_none():
    assert stated("nominal")[1] == {"wheels": None, "rates": None, "polarimeter": None}


def test_wheels_state_their_unloadings_and_what_these_leave():
    world, found = stated("wheels")
    wheels = found["wheels"]
    figures = asdict(world.scenario.wheels)
    size_n_m = figures.pop("torque_n_m")
    assert {name: wheels[name] for name in figures} == figures
    assert wheels["torque_n_m"] == [size_n_m] * 3
    assert 0.5 * size_n_m < wheels["constant_n_m"][0] < size_n_m
    assert wheels["unloading_us"] == [world.scenario.start_us + 12 * 3_600_000_000]
    left = np.array([unloaded(world.scenario.wheels, seed, number) for seed in range(200) for number in range(5)])
    # a thousand draws of two axes: the standard error of their rms is a percent
    assert np.sqrt(np.mean(left[:, [0, 2]] ** 2)) == pytest.approx(wheels["unloaded_n_m_s"], rel=0.04)
    assert np.abs(left[:, [0, 2]]).max() <= UNLOADED_SHARE * world.scenario.wheels.unloading_n_m_s


def test_rates_state_how_often_the_bias_is_as_large_as_the_catalogue_says():
    assert stated("rates_biased")[1]["rates"]["bias_factor"] == 5.0


def test_a_polarimeter_follows_yaw_and_states_when_its_feed_turns():
    world, found = stated("feed_turned")
    polarimeter = found["polarimeter"]
    assert np.linalg.norm(polarimeter["sight"]) == pytest.approx(1.0, abs=0.01)
    assert polarimeter["sight"][0] > 0.9
    assert polarimeter["feed_turn_from_us"] == world.scenario.operation_start_us + 20 * 3_600_000_000
    assert 0.1 / 3.0 < polarimeter["rain_deg_db"] < 0.3 / 3.0
