"""Ground lines: complete, valid JSON, shaped like the bodies of the interface."""

import itertools
import json
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from ground_story import ground_lines

from analyzer_sim.epochs import epoch_us_from_text
from analyzer_sim.world.ground.ground import catalogue_lines, chunks_of, turn_operations
from analyzer_sim.world.ground.ground_bodies import spacecraft_body
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.scenario.turns import TIMETABLE
from analyzer_sim.world.world import World


@cache
def world() -> World:
    return World(replace(scenario_named("demo"), quiet_h=2.5, operation_h=5.0), 1)


@cache
def lines() -> tuple[dict[str, Any], ...]:
    return tuple(json.loads(json.dumps(line, allow_nan=False)) for line in ground_lines(world()))


def bodies(kind: str) -> list[dict[str, Any]]:
    return [line["body"] for line in lines() if line["kind"] == kind]


def test_the_catalogue_comes_first_and_once() -> None:
    kinds = [line["kind"] for line in lines()]
    assert kinds[:4] == ["spacecraft", "carriers", "task", "ephemeris"]
    assert all(kinds.count(kind) == 1 for kind in kinds[:4])


def test_the_spacecraft_is_simulated_and_steered_by_the_paper_method() -> None:
    body = bodies("spacecraft")[0]
    assert body["simulated"] is True
    assert body["control"] == {"method": "robust", "mode": "ground", "release": "two_step"}
    assert body["onboard"] == {
        "fast_loop": True,
        "forecast_mode": True,
        "roll_yaw_coupling": True,
        "residual_torque_n_m": 0.0,
    }
    assert set(body["receiving_site"]) == {"name", "latitude_deg", "longitude_deg", "height_m"}


def test_carriers_have_exactly_the_fields_of_the_interface() -> None:
    fields = "id name station band transponder polarization uplink_hz downlink_hz intermediate_hz bandwidth_hz kind"
    expected = {*fields.split(), "uplink_power_control", "transponder_mode", "enabled"}
    carriers = bodies("carriers")[0]["carriers"]
    assert len(carriers) == 16
    assert all(set(carrier) == expected for carrier in carriers)
    assert all(10.7e9 < carrier["downlink_hz"] < 12.75e9 < carrier["uplink_hz"] < 14.5e9 for carrier in carriers)


def test_the_task_describes_the_plan() -> None:
    task, plan = bodies("task")[0], world().plan
    sweep = task["sweeps"][0]
    assert (sweep["rbw_hz"], sweep["points"], sweep["time_s"], sweep["detector"]) == (30e3, 2401, 2.0, "RMS")
    # point spacing at most half the resolution
    assert (sweep["stop_hz"] - sweep["start_hz"]) / (sweep["points"] - 1) <= sweep["rbw_hz"] / 2
    for carrier, entry in zip(plan.carriers, task["carriers"], strict=True):
        assert entry["id"] == carrier.id
        assert entry["fc_hz"] == carrier.center_hz
        assert entry["integ_bw_hz"] == pytest.approx(carrier.symbol_rate_hz * 1.25)  # roll-off 0.25
        assert sweep["start_hz"] < entry["fc_hz"] < sweep["stop_hz"]
        assert len(entry["noise"]) == 3


def test_the_ephemeris_covers_the_story_with_margin() -> None:
    body, phases = bodies("ephemeris")[0], world().scenario.phases
    nodes = [epoch_us_from_text(text) for text in body["ascending_nodes"]]
    epochs = [epoch_us_from_text(text) for text in body["track"]["epochs"]]
    assert nodes[0] < phases[0].start_us
    assert nodes[-1] > phases[-1].stop_us
    assert epochs[0] <= phases[0].start_us - 86_400_000_000
    assert epochs[-1] >= phases[-1].stop_us + 86_400_000_000
    assert body["nodal_period_s"] == pytest.approx(np.mean(np.diff(nodes)) / 1e6, abs=1e-3)  # told to a millisecond
    assert len(epochs) == len(body["track"]["latitude_deg"]) == len(body["track"]["longitude_deg"])


def test_each_tracked_row_has_one_reference_and_no_other_has() -> None:
    reported = [reference for body in bodies("references") for reference in body["references"]]
    epochs = [epoch_us_from_text(reference["epoch"]) for reference in reported]
    rows = world().rows.epochs_us
    assert epochs == rows[rows < world().scenario.operation_start_us].tolist()
    assert all(body["source"] == "star_tracker" for body in bodies("references"))
    assert reported[0]["sigma_deg"] == {"yaw": 0.015, "roll": 0.008, "pitch": 0.008}


def test_all_corrections_are_told_before_their_interval_is_swept() -> None:
    reported: list[tuple[int, int]] = []
    horizon_us = 0
    for line in lines():
        if line["kind"] == "corrections":
            for correction in line["body"]["corrections"]:
                start_us, stop_us = (epoch_us_from_text(correction[key]) for key in ("start", "stop"))
                assert start_us > horizon_us
                reported.append((start_us, stop_us))
        if line["kind"] == "truth":
            horizon_us = epoch_us_from_text(line["rows"][-1]["epoch"])
    assert reported == [(c.start_us, c.stop_us) for c in world().corrections]


def test_the_timetable_of_the_turns_is_told_at_their_start() -> None:
    operations = bodies("operations")
    assert operations == turn_operations(world().scenario.phases[1])
    assert {operation["kind"] for operation in operations} == {"calibration_turn"}
    attitudes = [tuple(json.loads(operation["comment"]).values()) for operation in operations]
    assert attitudes == [turn.attitude_deg for turn in TIMETABLE if any(turn.attitude_deg)]


def test_phases_follow_one_another() -> None:
    phases = [line for line in lines() if line["kind"] == "phase"]
    assert [phase["name"] for phase in phases] == ["quiet", "turns", "alignment", "operation"]
    assert all(a["stop"] == b["start"] for a, b in itertools.pairwise(phases))


def test_truth_has_every_row_once() -> None:
    rows = [row for line in lines() if line["kind"] == "truth" for row in line["rows"]]
    assert [epoch_us_from_text(row["epoch"]) for row in rows] == world().rows.epochs_us.tolist()
    angles = [[row["yaw_deg"], row["roll_deg"], row["pitch_deg"]] for row in rows]
    np.testing.assert_allclose(angles, world().rows.attitude_deg, atol=1e-7)  # told to 1e-7 deg


def test_truth_reaches_no_other_kind_of_line() -> None:
    names = {"truth", "flags", "uplink_fade_db", "downlink_fade_db"}
    for line in lines():
        if line["kind"] != "truth":
            text = json.dumps(line)
            assert not any(name in text for name in names)


def test_chunks_cover_all_rows_and_end_with_the_phases() -> None:
    chunks = chunks_of(world(), 60)
    assert [first for first, _last, _phase in chunks[1:]] == [last + 1 for _first, last, _phase in chunks[:-1]]
    assert chunks[0][0] == 0
    assert chunks[-1][1] == len(world().rows.epochs_us) - 1
    ends = {last + 1 for _first, last, _phase in chunks}
    starts = np.searchsorted(world().rows.epochs_us, [phase.start_us for phase in world().scenario.phases])
    assert set(starts[1:].tolist()) <= ends
    assert all(last - first < 60 for first, last, _phase in chunks)


def test_the_catalogue_alone_can_be_had() -> None:
    assert [line["kind"] for line in catalogue_lines(world())] == [
        *("spacecraft", "carriers", "task", "ephemeris", "bound")
    ]


def test_a_spacecraft_that_is_flown_states_no_torque_that_moves_its_wheels_alone() -> None:
    story = World(replace(scenario_named("wheels"), quiet_h=1.0, operation_h=1.0), 1)
    told, flown = (spacecraft_body(story, is_flown=each)["onboard"]["momentum"] for each in (False, True))
    assert told.pop("torque")["period_s"] == 86_400.0
    assert flown == told
