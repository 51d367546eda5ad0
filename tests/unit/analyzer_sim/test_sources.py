"""Beacons, sensors, two analyzers, new plans, silence and late news: what happens and what the ground is told."""

import json
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from ground_story import ground_lines

from analyzer_sim.epochs import epoch_us_from_text
from analyzer_sim.export import export_arrays
from analyzer_sim.world.ground.ground import carrier_body, chunks_of, task
from analyzer_sim.world.payload.effects import FaultFlag
from analyzer_sim.world.payload.level_terms import sensitivity_db_per_deg, users_noise_db
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World
from service.api.schemas.catalogue import CarrierPlanDocument
from service.api.schemas.inputs import CorrectionBatchDocument, ReferenceBatchDocument, TelemetryBatchDocument
from service.frontend.measurement_task import MeasurementTask

SEED = 3
NEW_WORLDS = ("beacons", "sensors", "prime_backup", "replan", "blackout", "few3", "corrections_late")


@cache
def world(name: str) -> World:
    return World(scenario_named(name), SEED)


@cache
def lines(name: str) -> tuple[dict, ...]:
    return tuple(json.loads(json.dumps(line, allow_nan=False)) for line in ground_lines(world(name)))


def bodies(name: str, kind: str) -> list[dict]:
    return [line["body"] for line in lines(name) if line["kind"] == kind]


def hours(name: str) -> np.ndarray:
    return (world(name).rows.epochs_us - world(name).scenario.operation_start_us) / 3.6e9


@pytest.mark.parametrize("name", NEW_WORLDS)
def test_users_have_the_noise_and_the_attitude_of_the_nominal_world(name: str) -> None:
    nominal, other = world("nominal"), world(name)
    np.testing.assert_array_equal(other.rows.attitude_deg, nominal.rows.attitude_deg)
    columns = [other.plan.column(carrier.id) for carrier in nominal.plan.carriers]
    is_plain = ~np.any(other.rows.flags[:, columns] & ~np.uint16(FaultFlag.STEP), axis=1)
    assert is_plain.mean() > 0.5
    # written to 1e-9: sums in another order differ in the last bits
    np.testing.assert_allclose(
        other.rows.carrier_dbm[is_plain][:1000, columns], nominal.rows.carrier_dbm[is_plain][:1000], atol=1e-9
    )


def test_a_beacon_moves_with_chain_rain_and_the_downlink_pattern_alone() -> None:
    story = world("beacons")
    beacons = [k for k, carrier in enumerate(story.plan.carriers) if carrier.is_beacon]
    assert beacons == [16, 17]
    rows = story.rows
    common_db = rows.chain_db - rows.downlink_fade_db
    gradient = sensitivity_db_per_deg(story.plan, story.orbit)[beacons]
    # both beacons of a band share one downlink
    np.testing.assert_allclose(gradient[0], gradient[1], atol=1e-12)
    assert 0.01 < np.abs(gradient[0]).max() < 1.0  # dB/deg, the downlink beam is flat
    own_db = rows.carrier_dbm[:, beacons] - common_db[:, None] - rows.attitude_deg @ gradient.T + 50.0
    # what is left: white 0.04 dB, drift 0.044 dB, curvature of the pattern at 0.5 deg
    print(f"seed {SEED}: own part of the beacons {own_db.std(axis=0)} dB")
    assert np.all(own_db.std(axis=0) < 0.12)
    np.testing.assert_array_equal(rows.uplink_fade_db[:, beacons], 0.0)


def test_a_beacon_drifts_by_a_twentieth_of_a_db_from_day_to_day() -> None:
    seconds = np.arange(0.0, 400 * 86_400.0, 3600.0)
    scenario = scenario_named("beacons", row_period_s=3600.0)
    drift = users_noise_db(world("beacons").plan, scenario, SEED, seconds)[:, 16]
    change = drift[24:] - drift[:-24]
    white = 2.0 * (0.06**2 - 0.046**2)
    # some 400 independent days: 4 %, five sigmas
    assert np.sqrt(change.var() - white) == pytest.approx(0.05, rel=0.2)


def test_a_beacon_has_no_station_and_no_uplink() -> None:
    reported = [carrier for carrier in bodies("beacons", "carriers")[0]["carriers"] if carrier["kind"] == "beacon"]
    assert [carrier["id"] for carrier in reported] == ["b00", "b01"]
    assert all(carrier["station"] is None and carrier["uplink_hz"] is None for carrier in reported)
    entries = [entry for entry in bodies("beacons", "task")[0]["carriers"] if entry["kind"] == "beacon"]
    assert [(entry["id"], entry["symbol_rate"], entry["integ_bw_hz"]) for entry in entries] == [
        ("b00", None, 100e3),
        ("b01", None, 100e3),
    ]
    assert task(world("nominal"), world("nominal").plan.carriers)["carriers"][0]["kind"] == "modulated"
    assert carrier_body(world("nominal"), world("nominal").plan.carriers[0])["station"] is not None


def test_each_sensor_tells_its_axes_and_no_others() -> None:
    reported = {body["source"]: [] for body in bodies("sensors", "references")}
    for body in bodies("sensors", "references"):
        reported[body["source"]] += body["references"]
    assert set(reported) == {"earth_sensor", "radio_beacon"}
    assert all(row["yaw_deg"] is None and row["sigma_deg"]["yaw"] is None for row in reported["earth_sensor"])
    assert all(row["roll_deg"] is None and row["pitch_deg"] is None for row in reported["radio_beacon"])
    assert reported["earth_sensor"][0]["sigma_deg"] == {"yaw": None, "roll": 0.03, "pitch": 0.03}
    assert reported["radio_beacon"][0]["sigma_deg"]["yaw"] == 0.1
    rows = np.sum(world("sensors").rows.epochs_us < world("sensors").scenario.operation_start_us)
    assert len(reported["earth_sensor"]) == rows
    # twenty minutes of each hour
    assert len(reported["radio_beacon"]) == pytest.approx(rows / 3, abs=20)


def test_sensors_have_their_noise_and_a_wandering_bias() -> None:
    story = world("sensors")
    reported = story.references
    is_earth = reported.source == "earth_sensor"
    truth = story.rows.attitude_deg[np.searchsorted(story.rows.epochs_us, reported.epochs_us)]
    error = (reported.attitude_deg - truth)[is_earth, 1:]
    # 4890 rows: 1 %, five sigmas
    np.testing.assert_allclose(np.diff(error, axis=0).std(axis=0) / np.sqrt(2.0), 0.03, rtol=0.05)
    # 81 hourly means: the white part leaves 0.0039, the bias wanders by 0.01 with a correlation time of 6 h
    hourly = error[: len(error) // 60 * 60].reshape(-1, 60, 2).mean(axis=1)
    print(f"seed {SEED}: hourly error {hourly.std(axis=0)} deg")
    assert np.all((hourly.std(axis=0) > 0.005) & (hourly.std(axis=0) < 0.02))
    yaw_error = (reported.attitude_deg - truth)[~is_earth, 0]
    assert yaw_error.std() == pytest.approx(0.1, rel=0.08)  # 1620 rows: 1.8 %, four sigmas


def test_the_export_tells_which_sensor_told_what() -> None:
    found = export_arrays(world("sensors"))
    is_earth = found["reference_source"] == "earth_sensor"
    assert np.all(np.isnan(found["reference_yaw_deg"]) == is_earth)
    assert np.all(np.isnan(found["reference_sigma_roll_deg"]) == ~is_earth)
    np.testing.assert_array_equal(found["reference_sigma_deg"], [0.1, 0.03, 0.03])
    plain = export_arrays(world("nominal"))
    assert set(plain["reference_source"].tolist()) == {"star_tracker"}
    np.testing.assert_array_equal(plain["reference_sigma_deg"], [0.015, 0.008, 0.008])


def test_the_backup_measures_for_hours_through_another_chain() -> None:
    story, found = world("prime_backup"), export_arrays(world("prime_backup"))
    is_backup = found["source"] == 1
    assert found["source_name"].tolist() == ["sa-1", "sa-2"]
    assert 6 * 60 <= is_backup.sum() <= 8 * 60 + 1
    change_db = found["chain_db"] - world("nominal").rows.chain_db
    np.testing.assert_allclose(change_db, np.where(is_backup, -0.4, 0.0), atol=1e-12)
    switches = [(epoch_us, source) for epoch_us, source in story.source_switches]
    assert [source for _epoch_us, source in switches] == ["sa-2", "sa-1"]
    assert bodies("prime_backup", "source") == [{"source": "sa-2"}, {"source": "sa-1"}]


def test_a_new_plan_comes_exactly_with_its_first_row() -> None:
    story = world("replan")
    plans = [[carrier["id"] for carrier in body["carriers"]] for body in bodies("replan", "carriers")]
    assert len(plans) == 2
    assert set(plans[0]) - set(plans[1]) == {"c06", "c13"}
    assert set(plans[1]) - set(plans[0]) == {"c16", "c17"}
    assert plans[1] == sorted(plans[1], reverse=True)
    power = export_arrays(story)["power_dbm"]
    after = hours("replan") >= 20.0
    for name, is_measured in (
        ("c06", ~after),
        ("c13", ~after),
        ("c16", after),
        ("c17", after),
        ("c00", after | ~after),
    ):
        np.testing.assert_array_equal(np.isfinite(power[:, story.plan.column(name)]), is_measured)
    assert int(np.argmax(after)) in {first for first, _last, _phase in chunks_of(story)}
    tasks = [[entry["id"] for entry in body["carriers"]] for body in bodies("replan", "task")]
    assert tasks == plans


def test_in_a_blackout_rows_of_nothing_come_and_later_none() -> None:
    rows = world("blackout").rows
    is_dark = ~rows.is_on.any(axis=1)
    assert is_dark.sum() == pytest.approx(180, abs=1)
    assert not np.any(rows.is_gap & is_dark)
    assert rows.is_gap.sum() == pytest.approx(300, abs=1)
    assert np.all(np.isnan(rows.power_dbm[is_dark | rows.is_gap]))
    assert world("blackout").emission(int(np.argmax(is_dark))).signals == ()
    truth = [row for line in lines("blackout") if line["kind"] == "truth" for row in line["rows"]]
    assert [row.get("is_gap", False) for row in truth] == rows.is_gap.tolist()


def test_only_three_stay() -> None:
    count = world("few3").rows.is_on.sum(axis=1)
    assert set(count.tolist()) == {3, 16}
    assert (count == 3).sum() == pytest.approx(360, abs=1)


def test_late_corrections_come_half_an_hour_after_their_end() -> None:
    story = world("corrections_late")
    found = export_arrays(story)
    np.testing.assert_array_equal(found["correction_told_us"], found["correction_stop_us"] + 1_800_000_000)
    reported = [line for line in json.loads(found["news_json"]) if line["kind"] == "corrections"]
    assert len(reported) == len(found["correction_told_us"])
    plain = export_arrays(world("nominal"))
    np.testing.assert_array_equal(plain["correction_told_us"], plain["correction_start_us"])
    assert not [line for line in json.loads(plain["news_json"]) if line["kind"] == "corrections"]
    swept_us = 0
    seen = 0
    for line in lines("corrections_late"):
        if line["kind"] == "corrections":
            for correction in line["body"]["corrections"]:
                # told with the chunk that holds its epoch: at most a chunk of an hour early
                assert epoch_us_from_text(correction["stop"]) + 1_800_000_000 > swept_us
                assert epoch_us_from_text(correction["stop"]) <= swept_us + 1_860_000_000
                seen += 1
        if line["kind"] == "truth":
            swept_us = epoch_us_from_text(line["rows"][-1]["epoch"])
    end_us = story.scenario.stop_us
    assert seen == sum(correction.reported_us < end_us for correction in story.corrections)


@pytest.mark.parametrize(
    "name", ["nominal", *(pytest.param(name, marks=pytest.mark.slow) for name in ("stale_calibration", "burn"))]
)
def test_telemetry_comes_hourly(name: str) -> None:
    records = [record for body in bodies(name, "telemetry") for record in body["records"]]
    fields = {"epoch", "onboard_mode", "wheel_momentum_n_m_s", "thrusters_active"}
    assert all(set(record) == fields for record in records)
    epochs_us = [epoch_us_from_text(record["epoch"]) for record in records]
    steps = {later - earlier for earlier, later in pairwise(epochs_us)}
    pause_us = round(world(name).scenario.pause_h * 3.6e9)
    assert all((step - 3_600_000_000) in {0, pause_us - pause_us % 3_600_000_000, pause_us} for step in steps)
    assert all(abs(value) < 20.0 for record in records for value in record["wheel_momentum_n_m_s"])
    before = [
        record for record in records if epoch_us_from_text(record["epoch"]) < world(name).scenario.operation_start_us
    ]
    assert {record["onboard_mode"] for record in before} == {"sensor_pointing"}
    assert {record["onboard_mode"] for record in records[len(before) :]} == {"inertial_forecast"}
    assert any(record["thrusters_active"] for record in records)


@pytest.mark.parametrize("seed", range(1, 4))
def test_the_switch_is_told_with_the_first_row_of_the_other_analyzer(seed: int) -> None:
    # switches fall between rows
    story = World(scenario_named("prime_backup"), seed)
    told_before = None
    for line in ground_lines(story):
        if line["kind"] == "source":
            told_before = line["body"]["source"]
        if line["kind"] == "truth" and told_before:
            row = int(np.searchsorted(story.rows.epochs_us, epoch_us_from_text(line["rows"][0]["epoch"])))
            names = export_arrays(story)["source_name"]
            assert names[story.rows.source[row]] == told_before
            assert names[story.rows.source[row - 1]] != told_before
            assert len(line["rows"]) == 1
            told_before = None


@pytest.mark.parametrize("name", ["beacons", "sensors", "prime_backup", "replan"])
def test_the_interface_takes_every_body(name: str) -> None:
    schemas = {
        "carriers": CarrierPlanDocument,
        "references": ReferenceBatchDocument,
        "corrections": CorrectionBatchDocument,
        "telemetry": TelemetryBatchDocument,
        "task": MeasurementTask,
    }
    seen = set()
    for line in lines(name):
        if line["kind"] in schemas:
            schemas[line["kind"]].model_validate_json(json.dumps(line["body"]))
            seen.add(line["kind"])
    assert seen == set(schemas)
