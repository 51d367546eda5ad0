"""Figures of the calibration."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from calibration_world import calibrated_world
from kept_results import kept

from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.carrier_model.expected_level import geometry_model
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.knowledge import JournalDocuments
from service.records.calibration import Window
from service.records.epoch import parse_epoch
from service.study.estimation.flight.drive import calibrate
from service.study.estimation.flight.world import simulated_world

SEEDS = (1, 2, 3)
#: at 0.3 deg, every sign of every axis, and between
ATTITUDES = np.random.default_rng(1).uniform(-0.3, 0.3, (300, 3))


#: what continuous integration judges, and what the night judges too
KINDS = ("nominal", "flicker", pytest.param("white", marks=pytest.mark.nightly))


@cache
def worlds(name):
    """Three seeds of a kind of noise, a week of operation each."""
    return [calibrated_world(name, seed) for seed in SEEDS]


def rms(values):
    return float(np.sqrt(np.mean(np.square(np.concatenate([np.ravel(one) for one in values])))))


# limits are the figures of seeds 1 to 3 with a third more for another machine's rounding and later seeds
LEVELS_DB = {"white": (0.008, 0.018), "nominal": (0.033, 0.040), "flicker": (0.11, 0.12)}
DEVIATION_DB = {"white": 0.015, "nominal": 0.033, "flicker": 0.046}
SLOPES_DB_PER_DEG = {"white": (0.010, 0.05, 0.042), "nominal": (0.025, 0.10, 0.085), "flicker": (0.06, 0.18, 0.12)}
SIGMA_DB = {"white": 0.02, "nominal": 0.14, "flicker": 0.26}


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_levels_are_predicted_days_later(name):
    """Beams on the orbit, dish law and solar day together; what all carriers share is the chain's."""
    first_db, seventh_db = LEVELS_DB[name]
    days = {day: [one.level_error_db(day) for one in worlds(name)] for day in (1, 3, 7)}
    shape = {day: [error - error.mean(axis=0) for error in errors] for day, errors in days.items()}
    print(
        f"{name}, seeds {SEEDS}: level error on day 1/3/7 {rms(days[1]):.4f}/{rms(days[3]):.4f}/{rms(days[7]):.4f} dB, "
        f"less each carrier's mean of the day {rms(shape[1]):.4f}/{rms(shape[3]):.4f}/{rms(shape[7]):.4f}; "
        "goals 0.02/-/0.05"
    )
    assert rms(days[1]) < first_db
    assert rms(days[7]) < seventh_db


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_beams_are_known_and_the_error_is_stated(name):
    deviations = [one.deviation_error_db(ATTITUDES) for one in worlds(name)]
    errors, standardised = (
        np.concatenate(both) for both in zip(*(w.slope_errors() for w in worlds(name)), strict=True)
    )
    slopes, own = np.sqrt((errors**2).mean(axis=0)), np.sqrt((standardised**2).mean(axis=0))
    print(f"{name}, seeds {SEEDS}: deviations {rms(deviations):.4f} dB, slopes {slopes} dB/deg, over own sigma {own}")
    assert rms(deviations) < DEVIATION_DB[name]
    assert (slopes < SLOPES_DB_PER_DEG[name]).all()
    # the downlink's part of the errors is common to all carriers: three worlds, not 48
    assert (own > 0.4).all()
    assert (own < 1.8).all()


@pytest.mark.slow
def test_what_a_missing_track_costs():
    """The figures that the warning names: two harmonics age with the plane of the orbit."""
    days = {1: [], 3: [], 7: []}
    for one in worlds("nominal"):
        untracked = replace(one.data, ephemeris=replace(one.data.ephemeris, track=None))
        found = replace(one, data=untracked, result=calibrate_geometry(untracked, CalibrationConfig()))
        for day, errors in days.items():
            errors.append(found.level_error_db(day))
    figures = {day: rms(errors) for day, errors in days.items()}
    print(f"nominal without a track, seeds {SEEDS}: level error on day 1/3/7 {figures}")
    # to the digits of the text, a tenth of a decibel of noise over three days being what it is
    assert figures == pytest.approx({1: 0.035, 3: 0.04, 7: 0.055}, abs=0.01)
    assert figures[7] > 1.5 * rms([one.level_error_db(7) for one in worlds("nominal")])


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_noise_is_what_the_world_has(name):
    for one in worlds(name):
        white = np.array([carrier.sigma_white_db for carrier in one.result.carriers])
        slow = np.array([[part.sigma_db for part in carrier.noise] for carrier in one.result.carriers])
        whole = np.sqrt((slow**2).sum(axis=1))
        print(f"{name}: white {np.median(white):.4f} of {np.median(one.arrays['white_db']):.4f}, slow {whole.round(3)}")
        # flicker's fastest parts are white to rows of a minute
        assert white / one.arrays["white_db"] == pytest.approx(
            np.ones(len(white)), abs=0.08 if name == "white" else 0.35
        )
        assert np.median(whole) < SIGMA_DB[name]
        if name == "flicker":
            assert np.median(whole) > 0.12


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_healthy_worlds_have_no_warning_of_the_joint_fit(name):
    for one in worlds(name):
        reported = [text for text in one.result.warnings if not text.startswith("paper method")]
        assert reported == [], (name, one.world.seed)


#: the calibration ends before the operation phase
OPERATION_DAYS = 0.05
DRAWS, FEW = range(1, 21), range(1, 6)


def calibrated(scenario, seed, share=1.0):
    """Return a world and its calibration by the first share of the turns."""
    world = simulated_world(scenario, seed, OPERATION_DAYS)
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
    response = geometry_model(result.geometry).response
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
