"""Figures of the attitude filter on the simulator's truth, errors of calibration left out.

Bounds are those of the method's goals where the filter reaches them, else what it reaches with room for seeds; the
goals stand beside the figures that are printed. Errors after one hour of settling, yaw, roll, pitch, deg.
"""

from dataclasses import replace

import numpy as np
import pytest

from analyzer_sim.scenario import downlink_rain, scenario_named
from service.core.estimation.filtering.filter_model import FilterSettings

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
    "yaw_hold": ((0.16, 0.025, 0.030), "study's skill .36-.61/.91-.96/.72-.94"),
    "demo": ((0.13, 0.020, 0.025), "no goal of its own"),
}


def campaign(robust_world, name, seeds):
    """Return the figures of a scenario by seed; they are printed too."""
    figures = [robust_world.RobustWorld(scenario_named(name), seed).drive().judged() for seed in seeds]
    with np.printoptions(precision=3, suppress=True):
        for seed, row in zip(seeds, figures, strict=True):
            print(f"{name} seed {seed}:", ", ".join(f"{key} {value}" for key, value in row.items()))
        print(f"{name} mean rms {np.mean([row['rms'] for row in figures], axis=0)} ({BOUNDS[name][1]})")
    return figures


def assert_bounds(name, figures):
    assert (np.mean([row["rms"] for row in figures], axis=0) <= BOUNDS[name][0]).all()
    ratio = np.mean([row["ratio"] for row in figures], axis=0)
    wrong_yaw = [row["wrong_yaw"] for row in figures]
    allowed = np.mean([row["yaw_available"] for row in figures])
    print(f"{name} mean rms/sigma {ratio.round(2)}, yaw wrong {wrong_yaw} min, allowed {allowed:.2f}")
    assert (ratio < 1.5).all(), "sigma must be honest"
    assert (ratio > 0.5).all()
    assert np.mean([row["available"] for row in figures]) >= 0.98
    assert sum(row["wrong_roll_pitch"] for row in figures) == 0
    # the must of mixed is 60 min; flicker asks for 10; a yaw turn that nobody announced takes its time to be seen
    assert np.mean(wrong_yaw) <= {"flicker": 10, "yaw_hold": 150}.get(name, 60)


@pytest.mark.slow
@pytest.mark.timeout(60)
@pytest.mark.parametrize("name", BOUNDS)
def test_scenarios_meet_their_bounds(robust_world, name):
    """Seed 2 of every scenario; five seeds in the nightly run."""
    assert_bounds(name, campaign(robust_world, name, SEEDS[1:]))


@pytest.mark.nightly
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", BOUNDS)
def test_scenarios_meet_their_bounds_over_five_seeds(robust_world, name):
    assert_bounds(name, campaign(robust_world, name, NIGHTLY_SEEDS))


@pytest.mark.slow
@pytest.mark.timeout(60)
@pytest.mark.parametrize("slope_db_min", [0.02, 0.05, 0.1, 0.3, 1.0, 3.0])
def test_downlink_rain_is_found_within_a_minute(robust_world, slope_db_min):
    """Delay after 0.3 dB, coverage of the wet rows, control back after the end; seeds 1 and 2."""
    delays, coverage, back = [], [], []
    for seed in SEEDS:
        scenario = replace(downlink_rain(slope_db_min, 3.0, 60.0), operation_h=14.0)
        told = robust_world.RobustWorld(scenario, seed).drive()
        wet = told.fade_db > 0.3
        begin, end = int(np.argmax(wet)), int(np.flatnonzero(told.fade_db > 0.05)[-1])
        delays.append(int(np.argmax(told.is_raining[begin:])))
        assert told.is_raining[begin : begin + 2].any()
        coverage.append(float(told.is_raining[wet].mean()))
        back.append(int(np.argmin(told.is_raining[end:])))
        assert not told.is_raining[: begin - 60].any(), "no rain in the dry"
    print(f"{slope_db_min} dB/min, seeds {SEEDS}: delays {delays} min, coverage {coverage}, back after {back} min")
    assert max(delays) <= 1
    assert min(coverage) >= 0.98
    assert max(back) <= 15


@pytest.mark.slow
@pytest.mark.timeout(60)
def test_a_filter_without_the_coupling_loses_yaw(robust_world):
    """The bound on yaw cannot be met without dynamics: the figure means something."""
    world = robust_world.RobustWorld(scenario_named("octants"), 1)
    without = world.drive(FilterSettings(coupling_per_h=0.0)).judged()
    print(f"octants seed 1 without coupling: rms {without['rms']}")
    assert without["rms"][0] > BOUNDS["octants"][0][0]
