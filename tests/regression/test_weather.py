"""Weather: reports, worlds and fades of the downlink."""

from dataclasses import replace

import numpy as np
import pytest
from driven_world import flown_by_paper
from kept_results import kept

from analyzer_sim.world.scenario.catalogue_plain import downlink_rain
from analyzer_sim.world.scenario.scenario import scenario_named
from service.pipeline.config import ChainConfig
from service.records.catalogue import Method
from service.records.inputs import WeatherReport
from service.study.estimation.campaign import Unit, run_unit
from service.study.estimation.flight.drive import drive
from service.study.estimation.flight.world import GroundEvent, simulated_world
from service.study.estimation.yardstick import measure_yardsticks

#: rows between two reports of a station
PERIOD = 10
STORM = ("weather_far", 6)
NIGHTLY = [("weather_far", seed) for seed in range(1, 11)] + [("weather_near", seed) for seed in range(1, 11)]


def reported(loss_db):
    return loss_db


def reported_everywhere(loss_db):
    return np.full_like(loss_db, 3.0)


def reported_nowhere(loss_db):
    return np.zeros_like(loss_db)


def reported_elsewhere(loss_db):
    """Return the rain of another station each, as after a mistake in the names."""
    return np.roll(loss_db, 5, axis=1)


def reported_inverted(loss_db):
    return np.where(loss_db > 0.15, 0.0, 1.0)


def flown(world, attenuation):
    """Return the yardstick of the robust method with reports every ten minutes, without any where there are none."""
    ground = world.ground
    if attenuation is not None:
        told_db = np.round(attenuation(np.maximum(world.truth.station_loss_db, 0.0)), 1)
        events = [
            GroundEvent(int(epoch_us), WeatherReport("radar", station, int(epoch_us), None, float(told_db[row, k])))
            for row, epoch_us in list(enumerate(ground.epochs_us))[::PERIOD]
            for k, station in enumerate(world.truth.stations)
            if station and world.truth.stations.index(station) == k
        ]
        ground = replace(ground, events=(*ground.events, *events))
    return measure_yardsticks(world, drive(ground), Method.ROBUST)["robust"]


def with_reports(scenario, seed, days, *attenuations):
    """Return the yardsticks without reports and with each kind of them, by name."""
    world = kept(simulated_world, scenario, seed, days)
    found = {}
    for each in (None, *attenuations):
        name = "no reports" if each is None else each.__name__
        found[name] = one = flown(world, each)
        print(
            f"{scenario} seed {seed} {name}: wrong {one.wrong_min:.0f} min, dry {one.allowed_dry:.3f}, "
            f"rms {np.round(one.rms_deg, 3)}, rms/sigma {np.round(one.rms_over_sigma, 2)}, "
            f"misleading {one.protection.misleading_share:.4f} in {one.protection.episodes}"
        )
    return found


@pytest.mark.slow
@pytest.mark.nightly
def test_reports_change_levels_and_wrong_ones_bring_no_wrong_torque():
    found = with_reports(*STORM, 0.8, reported, reported_everywhere, reported_inverted)
    assert all(one.wrong_min == 0.0 for one in found.values())
    assert found["reported"].allowed_dry >= found["no reports"].allowed_dry - 0.01
    assert found["reported_everywhere"].allowed_dry < found["reported"].allowed_dry


@pytest.mark.nightly
@pytest.mark.parametrize(("scenario", "seed"), NIGHTLY)
def test_reports_over_worlds(scenario, seed):
    found = with_reports(
        scenario, seed, None, reported, reported_everywhere, reported_nowhere, reported_elsewhere, reported_inverted
    )
    assert all(one.wrong_min <= 40.0 for one in found.values())


RELEARNED = ("weather_far", 6)
NIGHTLY_WORLDS = (
    ("weather_far", 2),
    ("weather_far", 8),
    ("weather_near", 5),
    ("weather_near", 7),
    ("weather_alignment", 1),
)


def assert_honest(scenario, seed):
    yardsticks = run_unit(Unit(scenario, seed)).yardsticks
    for name, one in yardsticks.items():
        level = one.protection
        told = "" if level is None else f", misleading {level.misleading_share:.4f} in {level.episodes}"
        print(
            f"{scenario} seed {seed} {name}: wrong {one.wrong_min:.0f} min, dry {one.allowed_dry:.3f}, "
            f"rms {np.round(one.rms_deg, 3)}, rms/sigma {np.round(one.rms_over_sigma, 2)}{told}"
        )
    robust = yardsticks["robust"]
    assert robust.wrong_min <= 40.0
    assert robust.protection.misleading_share <= 0.01
    assert robust.protection.without_share < 0.05
    assert robust.allowed_dry >= 0.75
    assert (robust.rms_over_sigma[1:] < 2.2).all()
    # the trivial answers fail where the method passes
    assert yardsticks["never allow"].allowed_dry == 0.0
    return yardsticks


@pytest.mark.slow
@pytest.mark.nightly
def test_rain_teaches_no_wrong_angle():
    yardsticks = assert_honest(*RELEARNED)
    assert yardsticks["robust"].wrong_min == 0.0
    assert yardsticks["robust"].protection.episodes == 0
    assert yardsticks["three sigma"].protection.misleading_share > 0.001


@pytest.mark.nightly
@pytest.mark.parametrize(("scenario", "seed"), NIGHTLY_WORLDS)
def test_rain_teaches_no_wrong_angle_over_worlds(scenario, seed):
    assert_honest(scenario, seed)


SEEDS = range(1, 11)
#: slopes of a fade, dB/min, and seeds; continuous integration flies four of the slowest and of the fastest
FADES = [(0.05, SEEDS[:4]), (3.0, SEEDS[:4])]
FADES += [pytest.param(slope, SEEDS, marks=pytest.mark.nightly) for slope in (0.05, 0.1, 0.3, 1.0, 3.0)]
#: rows are a minute apart
LATEST_STOP_MIN = 20


def _stop_delay_min(slope_db_min, seed):
    """Return how long after 0.3 dB control was stopped, None = never; fails when it was stopped in the dry before."""
    scenario = replace(downlink_rain(slope_db_min, 2.0, 40.0), operation_h=8.0)
    driven = flown_by_paper(scenario, seed)
    begin = int(np.flatnonzero(driven.downlink_fade_db > 0.3)[0])
    dry_before = driven.downlink_fade_db[:begin] == 0.0
    assert not driven.says("downlink_fade")[:begin][dry_before].any(), f"stopped in the dry, seed {seed}"
    stopped = np.flatnonzero(driven.says("downlink_fade")[begin:])
    return int(stopped[0]) if len(stopped) else None


@pytest.mark.slow
@pytest.mark.parametrize(("slope_db_min", "seeds"), FADES)
def test_a_fade_stops_control_in_time(slope_db_min, seeds):
    """In ten seeds a slope, control stops within 20 minutes after 0.3 dB."""
    delays = [_stop_delay_min(slope_db_min, seed) for seed in seeds]
    print(f"slope {slope_db_min} dB/min, seeds {list(seeds)}: delays {delays} min")
    in_time = [delay is not None and delay <= LATEST_STOP_MIN for delay in delays]
    # 95 % of the fifty cases may miss two in all; ten of one slope may miss none
    assert all(in_time)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_dry_excursions_never_stop_control(seed):
    """Two dry days through all octants raise no rain."""
    driven = flown_by_paper(scenario_named("demo"), seed)
    reached = np.abs(driven.truth_deg).max(axis=0)
    print(f"seed {seed}: largest excursions {reached.round(3)} deg")
    assert (reached > 0.25).all(), "the spacecraft must move for the claim to mean anything"
    assert (driven.downlink_fade_db == 0.0).all()
    assert not driven.says("downlink_fade").any()


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["nominal", "flicker"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_ten_quiet_days_raise_one_false_alarm_at_most(name, seed):
    driven = flown_by_paper(replace(scenario_named(name), operation_h=240.0), seed)
    is_stopped = ["downlink_fade" in row.inhibitions or "common_change" in row.inhibitions for row in driven.rows]
    alarms = int(np.count_nonzero(np.diff(np.array(is_stopped, dtype=int), prepend=0) == 1))
    print(f"{name}, seed {seed}: {alarms} alarms")
    assert alarms <= 1


@pytest.mark.slow
def test_the_rule_that_is_never_met_would_fail():
    """Control that never stops misses the bound: the figure cannot be met by doing nothing."""
    config = ChainConfig()
    deaf = replace(config, fade=replace(config.fade, depth_db=99.0))
    scenario = replace(downlink_rain(0.3, 2.0, 40.0), operation_h=8.0)
    driven = flown_by_paper(scenario, 1, deaf)
    assert not driven.says("downlink_fade").any()
    assert (driven.downlink_fade_db > 0.3).any()
