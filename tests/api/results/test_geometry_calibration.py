"""A calibration by geometry through the interface: asked for, made by its job, read by name, made the active one."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest
from geometry_payload import GeometryPayload, turned_angles

from service.core.estimation.noise_identification import LADDER_S
from service.records.epoch import format_epoch
from service.records.inputs import AttitudeReference
from service.records.levels.attitude import Axes

pytestmark = pytest.mark.anyio
SC = "/spacecraft/yamal-202"


def window(of) -> dict:
    return {"start": format_epoch(of.start_us), "stop": format_epoch(of.stop_us)}


@pytest.fixture
def payload(bench, make):
    """A day and a half of quiet and the turns, stored as a station would have sent them."""
    payload = GeometryPayload.make(8, quiet_days=1.5)
    catalogue, archive = bench.storage.catalogue, bench.storage.archive
    catalogue.replace_spacecraft(replace(payload.spacecraft, id=make.sc))
    plan = catalogue.put_plan(make.sc, payload.carriers, "geometry")
    catalogue.put_ephemeris(make.sc, payload.ephemeris())
    data = payload.data()
    for series in (data.quiet, data.turns):
        bench.append(series.epochs_us.tolist(), series.power_dbm, plan_id=plan.id)
    for reported in (*data.quiet_references, *data.references):
        columns = zip(reported.epochs_us, reported.attitude_deg, reported.sigma_deg, strict=True)
        archive.append_inputs(
            make.sc,
            [AttitudeReference(reported.source, int(at), Axes(*angle), Axes(*sigma)) for at, angle, sigma in columns],
        )
    return payload


async def calibrated(bench, payload, **changes) -> dict:
    """Ask for a calibration, wait for its job and return it with the job."""
    request = payload.request
    body = {"quiet": window(request.quiet), "turns": window(request.turns), "method": "geometry"} | changes
    answer = await bench.client.post(f"/api/v1{SC}/calibrations", json=body)
    assert answer.status_code == 202, answer.text
    started = answer.json()
    while (job := (await bench.client.get(f"/api/v1/jobs/{started['job']}")).json())["state"] not in {"done", "failed"}:
        await asyncio.sleep(0.02)
    return (await bench.get(f"/calibrations/{started['id']}")) | {"job": job}


async def test_a_calibration_by_geometry_is_told_by_name_and_activated(bench, payload):
    reported = await calibrated(bench, payload)
    assert reported["job"]["state"] == "done", reported["job"]
    assert (reported["method"], reported["state"], len(reported["carriers"])) == ("geometry", "draft", 8)
    found = np.array(
        [[c["sensitivity_db_per_deg"][axis] for axis in ("yaw", "roll", "pitch")] for c in reported["carriers"]]
    )
    # 0.05 dB on eight plateaus an axis: one sigma of yaw 0.003, of roll and pitch 0.013 dB/deg; five of them
    assert (np.abs(found - payload.slopes()).max(axis=0) < [0.03, 0.07, 0.07]).all()
    for carrier in reported["carriers"]:
        assert [part["correlation_time_s"] for part in carrier["noise"]] == list(LADDER_S)
        assert carrier["sigma_white_db"] == pytest.approx(0.05, rel=0.1)
        assert carrier["rejected_because"] is not None
    seen = reported["observability"]
    assert all(figure is not None for figure in (seen["condition"], *seen["dop"].values(), *seen["crlb_deg"].values()))
    assert seen["crlb_deg"]["roll"] < seen["crlb_deg"]["yaw"]
    assert reported["quality"]["carriers_used"] == 8.0
    assert (reported["quality"]["yaw_sign"], reported["quality"]["common_sign"]) == ("proven", "unproven")
    assert any(text.startswith("quiet window of 36.0 h is shorter") for text in reported["quality"]["warnings"])
    active = await bench.client.post(f"{bench.url}/calibrations/{reported['id']}:activate")
    assert (active.status_code, active.json()["state"]) == (200, "active")


@pytest.mark.parametrize("method", ["geometry", "paper"])
async def test_powers_of_another_clock_are_activated_for_a_reason_alone(bench, payload, make, method):
    """A sensor whose clock is fifteen minutes behind."""
    data = payload.data()
    sent = [
        AttitudeReference("other", int(at) - 900_000_000, Axes(*angle), Axes(*sigma))
        for one in (*data.quiet_references, *data.references)
        for at, angle, sigma in zip(one.epochs_us, one.attitude_deg, one.sigma_deg, strict=True)
    ]
    bench.storage.archive.append_inputs(make.sc, sent)
    reported = await calibrated(bench, payload, source="other", method=method)
    assert (reported["state"], reported["quality"]["turns"]) == ("draft", "contradicted")
    assert reported["quality"]["turn_lag_s"] == pytest.approx(900.0, abs=10.0)
    assert reported["quality"]["warnings"][0].startswith("the turns are inconsistent: the powers are 1")
    path = f"{bench.url}/calibrations/{reported['id']}:activate"
    refused = await bench.client.post(path)
    problem = refused.json()
    assert (refused.status_code, problem["code"]) == (409, "calibration.turns_inconsistent")
    assert "behind the other" in problem["detail"]
    active = await bench.client.post(path, json={"override_reason": "the front end was wrong, its rows are"})
    assert (active.status_code, active.json()["state"]) == (200, "active")
    stored = await bench.get(f"/calibrations/{reported['id']}")
    assert stored["override_reason"] == "the front end was wrong, its rows are"


@pytest.mark.slow
async def test_an_operation_inside_is_named(bench, payload):
    request = payload.request
    burn = {
        "kind": "station_keeping",
        "start": format_epoch(request.quiet.start_us + 3600_000_000),
        "stop": format_epoch(request.quiet.start_us + 5400_000_000),
    }
    assert (await bench.client.post(f"/api/v1{SC}/operations", json=burn)).status_code in {200, 201}
    reported = await calibrated(bench, payload)
    assert any("(station_keeping," in text for text in reported["quality"]["warnings"])


async def test_a_sensor_that_never_spoke_fails_in_words(bench, payload):
    reported = await calibrated(bench, payload, source="earth_sensor")
    assert reported["state"] == "failed"
    assert "have angles of earth_sensor" in reported["error"]


@pytest.mark.slow
async def test_announced_turns_prove_the_sign_of_all_axes(bench, payload):
    begin_us = payload.request.turns.start_us
    angles = turned_angles()
    steps = [k for k in range(1, len(angles)) if np.abs(angles[k] - angles[k - 1]).max() > 0.0]
    minute_us = 60_000_000
    changes = [
        {
            "start": format_epoch(begin_us + (k - 1) * minute_us),
            "stop": format_epoch(begin_us + k * minute_us),
            **dict(zip(("yaw_deg", "roll_deg", "pitch_deg"), (angles[k] - angles[k - 1]).tolist(), strict=True)),
        }
        for k in steps
    ]
    sent = await bench.client.post(f"/api/v1{SC}/corrections:batch", json={"corrections": changes})
    assert sent.json()["accepted"] == len(steps)
    assert (await calibrated(bench, payload))["quality"]["common_sign"] == "proven"
