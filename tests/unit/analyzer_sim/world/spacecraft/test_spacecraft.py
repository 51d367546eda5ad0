"""Attitude: coupling, corrections, bounds, phases."""

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from analyzer_sim.world.scenario.events import Hold
from analyzer_sim.world.scenario.manoeuvres import chunk_edges, holds_of, planned_deg
from analyzer_sim.world.scenario.scenario import KeepingErrors, Scenario, scenario_named
from analyzer_sim.world.scenario.turns import TIMETABLE, TURNS_H
from analyzer_sim.world.spacecraft.coupling import ORBITAL_RATE_PER_H, coupling_step
from analyzer_sim.world.spacecraft.spacecraft import AttitudeHistory, attitude_history

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


@pytest.mark.parametrize("seed", range(5))
def test_nominal_keeping_has_the_stated_size(seed: int) -> None:
    scenario = replace(scenario_named("nominal"), quiet_h=1.0)
    attitude = flown(scenario, seed).attitude_deg[epochs_of(scenario) >= scenario.operation_start_us]
    rms = np.sqrt(np.mean(attitude**2, axis=0))
    print(f"seed {seed}: rms {rms.round(3)}")
    # .093/.051/.059 deg on average; one run of two days scatters by a factor of two
    assert np.all((rms > 0.5 * np.array([0.093, 0.051, 0.059])) & (rms < 2.0 * np.array([0.093, 0.051, 0.059])))


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
