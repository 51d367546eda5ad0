"""Burns, ephemerides and the ground's news of them."""

import json
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from ground_story import ground_lines

from analyzer_sim.epochs import epoch_us_from_text
from analyzer_sim.export import export_arrays
from analyzer_sim.world.ground.ground import events
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World


@cache
def world(name: str, seed: int = 1) -> World:
    return World(replace(scenario_named(name), quiet_h=1.0), seed)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", ["burn", "maneuver"])
def test_a_burn_turns_the_orbit_and_moves_nothing_at_once(name: str, seed: int) -> None:
    orbit = world(name, seed).orbit
    impulse = orbit.impulses[0]
    at_us = np.array([impulse.epoch_us - 1, impulse.epoch_us])
    latitude, longitude = orbit.sub_satellite_deg(at_us)
    assert abs(np.diff(latitude)[0]) < 1e-7  # deg; a microsecond apart
    assert abs(np.diff(longitude)[0]) < 1e-4  # the small figure of eight takes the new plane at once
    before, after = np.hypot(*orbit.inclination_vector_deg(at_us))
    size_deg = float(np.hypot(*impulse.inclination_deg))
    print(f"{name}, seed {seed}: inclination {before:.4f} -> {after:.4f} deg by {size_deg:.4f} deg")
    assert 0.02 <= size_deg <= 0.035
    assert after < 0.065


def test_the_old_ephemeris_is_void_after_a_burn_and_the_new_one_is_not() -> None:
    story = world("burn")
    before, after = story.ephemerides
    burnt_us = story.orbit.impulses[0].epoch_us
    later_us = burnt_us + np.arange(6, 24, dtype=np.int64) * 3_600_000_000
    truth = story.orbit.sub_satellite_deg(later_us)[0]
    assert (
        np.abs(before.orbit.sub_satellite_deg(later_us)[0] - truth).max() > 0.015
    )  # deg, of 0.02-0.035 that it turned
    np.testing.assert_array_equal(after.orbit.sub_satellite_deg(later_us)[0], truth)
    assert after.reported_us - burnt_us == 6 * 3_600_000_000
    assert 23.5 * 3600.0 < after.nodal_period_s < 24.3 * 3600.0  # between nodes after the burn


def test_the_quiet_days_before_a_burn_do_not_know_it() -> None:
    burnt, plain = world("burn").rows, world("nominal").rows
    rows = burnt.epochs_us < world("burn").scenario.operation_start_us
    assert burnt.power_dbm[rows].tobytes() == plain.power_dbm[rows].tobytes()


def test_a_burn_is_declared_before_it_begins() -> None:
    operation = world("burn").operations[0]
    assert operation.kind == "station_keeping"
    assert operation.inhibit_control
    assert operation.attitude_uncertainty_deg == (0.2, 0.1, 0.1)
    assert operation.reported_us < operation.start_us < world("burn").orbit.impulses[0].epoch_us < operation.stop_us


def test_a_burn_disturbs_the_attitude_and_a_planned_one_does_not() -> None:
    plain = world("nominal").rows.attitude_deg
    hours = (world("burn").rows.epochs_us - world("burn").scenario.operation_start_us) / 3.6e9
    before, during = (int(np.searchsorted(hours, hour)) for hour in (20.1, 20.4))
    moved = np.diff(world("burn").rows.attitude_deg[[before, during]], axis=0)[0]
    # the thrusters' 0.12/0.07/-0.06 deg; drift and corrections of twenty minutes add some hundredths
    np.testing.assert_allclose(moved, [0.12, 0.07, -0.06], atol=0.05)
    assert world("maneuver").rows.attitude_deg.tobytes() == plain.tobytes()


@pytest.mark.parametrize("name", ["burn", "maneuver", "stale_calibration", "eclipse", "works", "nominal"])
def test_the_ground_port_and_the_export_tell_the_same_news_once(name: str) -> None:
    story = world(name)
    lines = list(ground_lines(story))
    first_truth = next(number for number, line in enumerate(lines) if line["kind"] == "truth")
    initial = {id(line) for line in lines[:5]}
    ported = [
        line
        for line in lines
        if id(line) not in initial
        and line["kind"] in {"carriers", "task", "ephemeris", "operations", "telemetry"}
        and line["body"].get("kind") != "calibration_turn"
    ]
    arrays = export_arrays(story)
    exported = json.loads(arrays["news_json"])
    assert first_truth > 4
    assert sorted(map(json.dumps, ported)) == sorted(map(json.dumps, exported))
    assert len(arrays["news_us"]) == len(exported)
    assert all(a <= b for a, b in pairwise(arrays["news_us"].tolist()))


@pytest.mark.parametrize("name", ["burn", "eclipse", "sun_outage", "works"])
def test_operations_have_the_fields_of_the_interface(name: str) -> None:
    bodies = [line["body"] for _reported_us, line in events(world(name)) if line["kind"] == "operations"]
    fields = {"kind", "start", "stop", "carriers", "transponders", "inhibit_control", "comment"}
    assert bodies
    for body in bodies:
        assert fields <= set(body) <= {*fields, "attitude_uncertainty_deg"}
        assert epoch_us_from_text(body["start"]) < epoch_us_from_text(body["stop"])


def test_operations_are_told_before_they_begin() -> None:
    horizon_us, reported = 0, 0
    for line in ground_lines(world("works")):
        if line["kind"] == "truth":
            horizon_us = epoch_us_from_text(line["rows"][-1]["epoch"])
        if line["kind"] == "operations" and line["body"]["kind"] != "calibration_turn":
            assert epoch_us_from_text(line["body"]["start"]) > horizon_us
            reported += 1
    assert reported == 3


def test_a_new_plan_has_its_task_and_begins_with_the_alignment() -> None:
    story = world("stale_calibration")
    kinds = [line["kind"] for line in ground_lines(story)]
    assert (kinds.count("carriers"), kinds.count("task"), kinds.count("ephemeris")) == (2, 2, 2)
    lines = list(ground_lines(story))
    position = max(number for number, kind in enumerate(kinds) if kind == "carriers")
    following = next(line for line in lines[position:] if line["kind"] == "phase")
    assert following["name"] == "alignment"
    ids = [carrier["id"] for carrier in lines[position]["body"]["carriers"]]
    assert ids == [carrier["id"] for carrier in lines[position + 1]["body"]["carriers"]]
    assert {"c16", "c17"} <= set(ids)
    assert not {"c06", "c13"} & set(ids)


def test_truth_lines_name_what_is_faulty_and_others_do_not() -> None:
    faulty = [
        row
        for line in ground_lines(world("works"))
        if line["kind"] == "truth"
        for row in line["rows"]
        if "faults" in row
    ]
    assert any("off" in names for row in faulty for names in row["faults"].values())
    secrets = ("faults", "chain_db", "uplink_fade_db", "burn_", "impulse")
    for line in ground_lines(world("burn")):
        if line["kind"] != "truth":
            assert not any(secret in json.dumps(line) for secret in secrets)


@pytest.mark.parametrize(
    ("name", "mode", "control", "coupling"),
    [
        ("alc", {"alc", "fixed_gain"}, {"none"}, True),
        ("upc", {"fixed_gain"}, {"none", "auto"}, True),
        ("upc_untold", {"fixed_gain"}, {"none", "unknown"}, True),
        ("no_coupling", {"fixed_gain"}, {"none"}, False),
        ("nominal_uncoupled", {"fixed_gain"}, {"none"}, True),
    ],
)
def test_the_catalogue_says_what_the_ground_believes(name: str, mode: set, control: set, coupling: bool) -> None:
    lines = list(ground_lines(world(name)))
    carriers = lines[1]["body"]["carriers"]
    assert {carrier["transponder_mode"] for carrier in carriers} == mode
    assert {carrier["uplink_power_control"] for carrier in carriers} == control
    assert lines[0]["body"]["onboard"]["roll_yaw_coupling"] is coupling
