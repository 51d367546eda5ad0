"""Studies as processes: the figures, the files and the exit codes."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from child_processes import descendants_of
from typer.testing import CliRunner
from waiting import wait_until

from service.cli.app import app
from service.records.catalogue import Method
from service.study.closed_loop.controllers import Sensing
from service.study.closed_loop.plant_process import PlantFailedError
from service.study.closed_loop.run import LoopUnit, fly_unit
from service.study.estimation.bounds import Mark
from service.study.estimation.flight.world import ExportFailedError, read_carriers, read_world, simulated_world
from service.study.estimation.trials.snapshot_trials import run_trials, trial_statistics

pytestmark = pytest.mark.system


SEED = 1
HOURS = 3.0


def flown(sensing: Sensing, uplink: str = "link", scenario: str = "nominal"):
    result = fly_unit(LoopUnit(scenario, SEED, sensing, uplink, HOURS / 24.0))
    assert result.refusal == ""
    return result.flight


@pytest.mark.slow
def test_perfect_sensing_holds_the_craft_that_is_lost_without_control():
    held, lost = flown(Sensing.TRUTH), flown(Sensing.OFF)
    largest, free = (np.abs(flight.truth_deg).max(axis=0) for flight in (held, lost))
    print(f"seed {SEED}, {HOURS:g} h, yaw/roll/pitch: held {largest.round(3)} deg, free {free.round(3)} deg")
    assert largest.max() < 0.1
    assert free[1:].max() > 0.4
    assert held.sent > 20
    # one in fifty is lost, the last ones are still under way
    assert 0.85 * held.sent < held.reported["executed"] <= held.sent
    assert held.reported["late"] == held.reported["refused"] == 0
    assert lost.sent == 0


@pytest.mark.slow
def test_the_chain_holds_roll_and_pitch_over_a_link():
    flight = flown(Sensing.AUTOMATIC)
    rows = round(HOURS * 60.0)
    assert len(flight.hours) == rows
    assert np.isfinite(flight.estimate_deg).all()
    largest = np.abs(flight.truth_deg).max(axis=0)
    print(f"seed {SEED}, {HOURS:g} h, yaw/roll/pitch: {largest.round(3)} deg, {flight.sent} commands")
    # lost without control in an hour and a half
    assert largest[1:].max() < 0.2
    # the level of the first rows has the noise of few, and is to be good for ten minutes; then the interlock waits ten
    assert not flight.is_inhibited[25:].any()
    assert flight.trips == ()
    # one every ten minutes at most, each told once when it is over
    assert 12 <= flight.sent <= HOURS * 6
    over = {state: count for state, count in flight.reported.items() if state != "executing"}
    assert flight.sent - 3 <= over["executed"] <= sum(over.values()) <= 2 * flight.sent


@pytest.mark.slow
def test_the_known_torque_is_balanced_through_a_fade_in_mid_slew():
    """Before, control stood still in the fade, and pitch of this seed went to 0.44 deg."""
    flight = fly_unit(LoopUnit("slew_fade", SEED, Sensing.AUTOMATIC, "link", 0.25)).flight
    largest = np.abs(flight.truth_deg).max(axis=0)
    print(
        f"seed {SEED}, yaw/roll/pitch: {largest.round(3)} deg, inhibited {flight.is_inhibited.mean():.2f} of the rows"
    )
    assert flight.is_inhibited.mean() > 0.15
    assert largest[1:].max() < 0.4


@pytest.mark.slow
def test_the_published_method_comes_back_from_a_fade_in_mid_slew():
    """Before, the turn during the stop kept the levels away, so the stop never ended: 5 of 6 were lost."""
    flight = fly_unit(LoopUnit("slew_fade", 3, Sensing.AUTOMATIC, "link", 0.25, method=Method.PAPER)).flight
    largest, end = np.abs(flight.truth_deg).max(axis=0), np.abs(flight.truth_deg[-1])
    print(f"seed 3, yaw/roll/pitch: {largest.round(3)} deg, {end.round(3)} at the end")
    assert 0.4 < largest[1:].max() < 0.8
    assert end[1:].max() < 0.2
    assert flight.trips == ()


@pytest.mark.slow
def test_a_loop_on_board_holds_on_angles_and_stops_without_them():
    """Angles go up in place of torques; an hour and a half without uplink, of which half an hour is bridged."""
    unit = LoopUnit("nominal", SEED, Sensing.AUTOMATIC, "link", 6.0 / 24.0, mode="onboard", silence_h=(3.0, 1.5))
    result = fly_unit(unit)
    assert result.refusal == ""
    flight = result.flight
    largest = np.abs(flight.truth_deg).max(axis=0)
    held_h = flight.hours[flight.is_inhibited]
    end_deg = flight.truth_deg[-1].round(3)
    print(f"seed {SEED}: {largest.round(3)} deg, {end_deg} at the end, held {held_h.min():.2f} to {held_h.max():.2f} h")
    # beyond 0.4 deg no angles go up any more
    assert largest[1:].max() < 0.4
    assert np.abs(flight.truth_deg[-1, 1:]).max() < 0.2
    # until the first product, and from the age limit to the first product after the silence
    late = held_h[held_h > 1.0]
    assert late.min() == pytest.approx(3.5, abs=0.1)
    assert late.max() == pytest.approx(4.55, abs=0.15)
    assert flight.reported["executed"] > 100
    assert flight.reported["late"] == flight.reported["refused"] == 0


#: of a row each 120 to 300 s, all three shapes of the torque among them: the others take minutes
SHORT_SEEDS = dict.fromkeys((6, 7, 8, 12), pytest.mark.slow)


@pytest.mark.parametrize(
    "plant_seed",
    [pytest.param(seed, marks=SHORT_SEEDS.get(seed, pytest.mark.nightly)) for seed in range(1, 25)],
)
def test_no_varied_plant_is_lost(plant_seed):
    """Yaw within 1 deg is wanted of 23; what it is says the evidence."""
    result = fly_unit(LoopUnit("plant_varied", plant_seed, Sensing.AUTOMATIC))
    assert result.refusal == ""
    flight = result.flight
    largest = np.abs(flight.truth_deg).max(axis=0)
    print(f"seed {plant_seed}: {largest.round(3)} deg, no control {flight.is_inhibited.mean():.3f}, {flight.reasons}")
    assert largest[1:].max() < 0.5
    assert largest[0] < 3.0
    assert flight.trips == ()
    # twice 40 min a day for thrusters that nobody declared, in which the known torque is balanced
    assert flight.is_inhibited.mean() <= 0.1


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_yaw_is_held_by_reported_wheels_whose_torque_nobody_states():
    """Within 0.25 deg in 17 of 20 runs, 19 are wanted; seeds 2, 16 and 18 pass it by 0.02. No control keeps none."""
    command = ["study", "closed-loop", "--scenario", "wheels_unstated", "--operation-days", "1", "--json"]
    held = CliRunner().invoke(app, [*command, "--runs", "20", "--sensing", "automatic"])
    free = CliRunner().invoke(app, [*command, "--runs", "3", "--sensing", "off"])
    groups = [json.loads(announced.stdout)["groups"][0] for announced in (held, free)]
    print([(group["survived_share"], group["largest_deg"]) for group in groups])
    assert groups[0]["survived_share"] >= 0.8
    assert groups[0]["largest_deg"][-1][0] < 0.3
    assert groups[0]["level_share"] == 1.0
    assert (free.exit_code, groups[1]["survived_share"]) == (0, 0.0)


def test_an_unknown_mode_is_refused():
    announced = CliRunner().invoke(app, ["study", "closed-loop", "--mode", "pigeon"])
    assert (announced.exit_code, "no mode 'pigeon'" in announced.output) == (2, True)


def test_an_unknown_scenario_is_the_plants_to_refuse():
    with pytest.raises(PlantFailedError, match="invalid choice"):
        fly_unit(LoopUnit("unheard", SEED, Sensing.OFF))
    announced = CliRunner().invoke(app, ["study", "closed-loop", "--runs", "1", "--uplink", "pigeon"])
    assert announced.exit_code == 2
    assert "no uplink 'pigeon'" in announced.output


STUDY = [sys.executable, "-m", "service", "study", "estimation"]


@pytest.mark.slow
def test_a_short_study_prints_figures_bounds_and_marks(compiled_environment, tmp_path):
    arguments = ["--scenario", "white", "--seeds", "1", "--workers", "1", "--operation-days", "0.2", "--json"]
    ran = subprocess.run(
        [*STUDY, *arguments, "--figures", str(tmp_path)],
        env=compiled_environment,
        capture_output=True,
        text=True,
        timeout=540,
        check=False,
    )
    # 1: an operation of five hours is too short for bounds that were set for two days
    assert ran.returncode in (0, 1), ran.stderr
    assert "Traceback" not in ran.stderr
    document = json.loads(ran.stdout)
    assert document["command"] == "soo study estimation --scenario white --seeds 1 --operation-days 0.2"
    figures = document["figures"]["white"]
    trivial = {"never allow", "always allow", "three sigma"}
    baselines = {"zero", "corrections", "corrections_read", "coupling"}
    assert set(figures) == {"robust", "paper", "oracle"} | baselines | trivial
    for method in ("robust", "paper"):
        assert figures[method]["answered"] == 1.0
        # generous: a snapshot of one row has 0.05 deg of roll and 0.14 of pitch
        assert figures[method]["rms_deg.roll"] < 0.1
        assert figures[method]["rms_deg.pitch"] < 0.15
    assert figures["zero"]["rms_deg.roll"] == figures["robust"]["truth_rms_deg.roll"]
    assert figures["robust"]["rms_deg.roll"] < min(figures[name]["rms_deg.roll"] for name in ("zero", "coupling"))
    assert {bound["mark"] for bound in document["bounds"]} <= {mark.value for mark in Mark}
    assert {bound["scenario"] for bound in document["bounds"]} == {"white"}
    drawn = ["overview.png", "smoothed_white.png", "stanford_white.png", "white.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == drawn


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_signal_ends_the_study_with_all_its_processes(number, compiled_environment, tmp_path):
    log = tmp_path / "out"
    with log.open("wb") as output:
        process = subprocess.Popen(
            [*STUDY, "--group", "quick", "--seeds", "3"], env=compiled_environment, stdout=output, stderr=output
        )
    try:
        # two workers, the tracker of their resources, and simulators below the workers
        wait_until(lambda: len(descendants_of(process.pid)) >= 4, log.read_text)
        children = descendants_of(process.pid)
        process.send_signal(number)
        assert process.wait(120) == 2, log.read_text()
    finally:
        process.kill()
        process.wait()
    wait_until(lambda: not any(Path(f"/proc/{child}").exists() for child in children), "the end of its processes")
    assert "stopped" in log.read_text()
    assert "Traceback" not in log.read_text()


def test_a_world_is_read_as_it_was_written(tmp_path):
    path = tmp_path / "world.npz"
    story = ("--scenario", "stale_calibration", "--seed", "3", "--operation-days", "0.1")
    subprocess.run([sys.executable, "-m", "analyzer_sim", "export", *story, "--out", str(path)], check=True)
    world = read_world(path)
    with np.load(path) as file:
        written = {name: file[name] for name in file.files}
    ground, truth = world.ground, world.truth
    assert (world.scenario, world.seed, world.row_period_s) == ("stale_calibration", 3, 60.0)
    # the archive keeps 32 bits: 4e-6 dB at 60 dBm
    np.testing.assert_allclose(ground.power_dbm, written["power_dbm"], atol=4e-6)
    assert not np.array_equal(ground.power_dbm, written["power_dbm"], equal_nan=True)
    np.testing.assert_array_equal(truth.attitude_deg[:, 1], written["roll_deg"])
    assert tuple(ground.phases) == ("quiet", "turns", "pause", "alignment", "operation")
    assert ground.sensors == ("star_tracker",) * 3
    lines = {line["kind"]: line["body"] for line in json.loads(str(written["catalogue_json"])) if "body" in line}
    assert ground.carriers == read_carriers(lines["carriers"])
    plans = [events.content for events in ground.events if isinstance(events.content, tuple)]
    assert {carrier.id for carrier in plans[0]} - {carrier.id for carrier in ground.carriers} == {"c16", "c17"}
    # told no later than they begin
    assert all(
        events.reported_us <= events.content.start_us
        for events in ground.events
        if events.content in ground.corrections
    )


def test_a_world_that_cannot_be_made_says_why():
    with pytest.raises(ExportFailedError, match=r"no world of nosuch, seed 1: .*invalid choice"):
        simulated_world("nosuch", 1)


@pytest.mark.slow
def test_trials_of_the_snapshot_reach_their_bounds_with_one_seed():
    figures = trial_statistics([run_trials(1)])
    print(f"seed 1: {figures}")
    for axis in ("yaw", "roll", "pitch"):
        # 2500 fixes: one sigma of a ratio is 1 / sqrt(5000) = 0.014
        assert figures[f"over_bound_true.{axis}"] == pytest.approx(1.0, abs=0.05)
        # one calibration only: must hold on the mean of eight, half as much again is allowed to one
        assert figures[f"over_bound_fitted.{axis}"] < 1.5
    # one calibration: one sigma of the scale is 0.1
    assert figures["yaw_scale"] == pytest.approx(1.0, abs=0.3)
    assert figures["breakdown"] >= 5
    # what must hold on the mean of eight seeds, and half as much again
    assert figures["level_day1_db"] < 0.075
    assert figures["level_day7_db"] < 0.18
    assert figures["false_exclusion_share"] <= 0.01
