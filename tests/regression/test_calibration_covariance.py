"""Sigma of the slopes that a calibration states, against the truth of the simulator: in the dry and in a storm."""

import re
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from kept_results import kept

from service.pipeline.carrier_model.calibrated_arrays import geometry_model
from service.pipeline.inputs.documents import JournalDocuments
from service.records.calibration import Window
from service.records.epoch import parse_epoch
from service.study.estimation.flight.drive import calibrate
from service.study.estimation.flight.world import export_world, read_world

#: the calibration ends before the operation phase
OPERATION_DAYS = 0.05
DRAWS, FEW = range(1, 21), range(1, 6)


def calibrated(scenario, seed, share=1.0):
    """Return a world and its calibration by the first share of the turns."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "world.npz"
        export_world(scenario, seed, path, OPERATION_DAYS)
        world = read_world(path)
    turns = world.ground.phases["turns"]
    flown = Window(turns.start_us, turns.start_us + round(share * (turns.stop_us - turns.start_us)))
    ground = replace(world.ground, phases=world.ground.phases | {"turns": flown})
    documents = JournalDocuments()
    documents.add_plan(ground.carriers)
    documents.add_ephemeris(ground.ephemeris)
    return world, calibrate(ground, documents.plans[1], documents.ephemerides[1]).result


def normalised_errors(scenario, seed):
    """Return errors of the slopes over their sigmas (n, 3), yaw, roll, pitch, of the carriers used."""
    world, result = calibrated(scenario, seed)
    response = geometry_model(result.geometry, result.carriers).response
    column = [world.ground.carrier_ids.index(carrier.id) for carrier in result.carriers]
    error = response.slope - world.truth.sensitivity_db_per_deg[column]
    sigma = np.sqrt(np.einsum("nii->ni", response.covariance)[:, :3])
    return (error / sigma)[np.array(result.geometry.is_used)]


def pooled(scenario, seeds):
    every = np.concatenate([kept(normalised_errors, scenario, seed) for seed in seeds])
    rms = np.sqrt((every**2).mean(axis=0))
    print(f"{scenario}, {len(seeds)} draws: normalised errors of yaw, roll, pitch {np.round(rms, 2)}, n {len(every)}")
    return rms


@pytest.mark.slow
def test_slopes_are_as_sure_as_they_say():
    # carriers of a draw share a downlink and a sensor: the rms of a draw itself lies between 0.5 and 1.3
    rms = pooled("nominal", FEW)
    assert ((rms > 0.6) & (rms < 1.5)).all()


def again(scenario, seed, share=1.0):
    """Return the demands to fly turns again."""
    _, result = kept(calibrated, scenario, seed, share)
    return [text for text in result.warnings if text.startswith("fly the turns of ")]


@pytest.mark.slow
def test_turns_in_a_storm_are_to_be_flown_again_and_say_so_before_they_are_over():
    for share in (0.3, 1.0):
        (text,) = again("weather_turns", 1, share)
        first, last = (parse_epoch(word) for word in re.findall(r"\d{4}-\S+Z", text)[:2])
        world, _ = kept(calibrated, "weather_turns", 1, share)
        turns = world.ground.phases["turns"]
        assert turns.start_us <= first < last < turns.start_us + share * (turns.stop_us - turns.start_us)
        is_named = (world.ground.epochs_us >= first) & (world.ground.epochs_us <= last)
        assert (world.truth.station_loss_db[is_named] > 0.3).sum(axis=1).mean() > 2.0
    assert again("nominal", 1) == []


@pytest.mark.nightly
@pytest.mark.parametrize("scenario", ["nominal", "weather_far", "weather_turns"])
def test_slopes_are_as_sure_as_they_say_over_draws(scenario):
    rms = pooled(scenario, DRAWS)
    assert ((rms > 0.8) & (rms < 1.2)).all()
