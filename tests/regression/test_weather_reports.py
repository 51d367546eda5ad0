"""Reports of rain over the stations: true ones help, wrong ones cost certainty, never truth."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from kept_results import kept

from service.records.catalogue import Method
from service.records.inputs import WeatherReport
from service.study.estimation.flight.drive import drive
from service.study.estimation.flight.world import GroundEvent, export_world, read_world
from service.study.estimation.yardstick import measure_yardsticks

#: rows between two reports of a station
PERIOD = 10
STORM = ("weather_far", 6)
NIGHTLY = [("weather_far", seed) for seed in range(1, 11)] + [("weather_near", seed) for seed in range(1, 11)]


def made(scenario, seed, days):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "world.npz"
        export_world(scenario, seed, path, days)
        return read_world(path)


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
    world = kept(made, scenario, seed, days)
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


@pytest.mark.nightly
@pytest.mark.slow
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
