"""Attitude: newest, history, validity."""

from itertools import pairwise

import pytest

from service.ports import LIVE, Outcome
from service.records.catalogue import Method
from service.records.epoch import format_epoch
from service.records.levels.attitude import NO_ANGLES, Exclusion, Status

pytestmark = pytest.mark.anyio


async def test_before_the_first_row_nothing_is_received(bench):
    newest = await bench.get("/attitude")
    assert newest["status"] == "NOT_RECEIVED"
    assert newest["control_allowed"] is False
    assert newest["inhibitions"] == ["no_attitude"]
    absent = ("epoch", "received_at", "yaw_deg", "roll_deg", "pitch_deg", "rates_deg_s", "common_db", "calibration_id")
    assert [newest[name] for name in absent] == [None] * len(absent)
    assert newest["sigma_deg"] == {"yaw": None, "roll": None, "pitch": None}
    assert newest["method"] == "paper", "the method that drives control"
    assert (await bench.get("/attitude", method="robust"))["method"] == "robust"


async def test_row_is_told_field_by_field(bench, make):
    (row,) = bench.append([make.now_us - 30 * make.s])
    bench.consume([Outcome((make.row(row, common_db=make.nan),), None)])
    newest = await bench.get("/attitude")
    assert newest.pop("control") == (await bench.get("/control"))["control"]
    told = {
        "epoch": "2026-11-21T02:59:30.000000Z",
        "received_at": "2026-11-21T02:59:32.000000Z",
        "method": "paper",
        "yaw_deg": 0.1,
        "roll_deg": -0.02,
        "pitch_deg": 0.03,
        "rates_deg_s": {"yaw": 1e-6, "roll": -2e-6, "pitch": 3e-6},
        "sigma_deg": {"yaw": 0.2, "roll": 0.01, "pitch": 0.02},
        "status": "ACQUIRED",
        "control_allowed": True,
        "control_allowed_axes": {"yaw": False, "roll": True, "pitch": True},
        "inhibitions": [],
        "carriers_used": 14,
        "excluded": [{"carrier": "c03", "reason": "uplink_fade"}, {"carrier": "c05", "reason": "absent"}],
        "downlink_fade": False,
        "downlink_fade_db": 0.0,
        "common_db": None,
        "residual_rms_db": 0.15,
        "calibration_id": 1,
        "alignment_id": 1,
        "advice": [],
        "version": "live",
    }
    assert {name: newest[name] for name in told} == told


async def test_row_of_the_robust_method_tells_levels_reasons_and_advice(bench, make):
    (row,) = bench.append([make.now_us - 30 * make.s])
    words = ("uplink_fade", "step", "absent", "interference", "group", "manual")
    reported = make.row(
        row,
        method=Method.ROBUST,
        excluded=tuple(Exclusion(f"c{k:02d}", word) for k, word in enumerate(words)),
        downlink_fade=True,
        downlink_fade_db=1.75,
        common_db=-0.125,
        rates_deg_s=None,
        inhibitions=("downlink_fade",),
        control_allowed=False,
        control_allowed_axes=(False, False, False),
        advice=("realign", "disagreement"),
    )
    bench.consume([Outcome((make.row(row), reported), None)])
    newest = await bench.get("/attitude", method="robust")
    assert [item["reason"] for item in newest["excluded"]] == list(words)
    assert (newest["downlink_fade"], newest["downlink_fade_db"], newest["common_db"]) == (True, 1.75, -0.125)
    assert newest["advice"] == ["realign", "disagreement"]
    (row_of_history,) = (await bench.get("/attitude/history", method="robust"))["rows"]
    assert row_of_history | {"control": newest["control"]} == newest
    assert (await bench.get("/status"))["realignment_advised"] is True
    assert (await bench.get("/attitude"))["advice"] == [], "the paper method has its own"


async def test_row_without_a_fix_has_nulls_and_its_reasons(bench, make):
    (row,) = bench.append([make.now_us])
    lost = make.row(
        row,
        attitude_deg=NO_ANGLES,
        sigma_deg=NO_ANGLES,
        rates_deg_s=None,
        status=Status.INVALID,
        control_allowed=False,
        control_allowed_axes=(False, False, False),
        inhibitions=("no_fix",),
    )
    bench.consume([Outcome((lost,), None)])
    newest = await bench.get("/attitude")
    assert (newest["yaw_deg"], newest["rates_deg_s"], newest["status"]) == (None, None, "INVALID")
    assert newest["inhibitions"] == ["no_fix"]
    robust = await bench.get("/attitude", method="robust")
    assert (robust["status"], robust["inhibitions"]) == ("INVALID", ["no_calibration"]), "what nobody computed"


async def test_old_row_expires_under_the_system_clock_only(bench, make):
    (row,) = bench.append([make.now_us])
    bench.consume([Outcome((make.row(row),), None)])
    bench.clock.system = make.now_us + 210 * make.s
    assert (await bench.get("/attitude"))["status"] == "ACQUIRED", "three row periods and 30 s are allowed"
    bench.clock.system += 1
    expired = await bench.get("/attitude")
    assert (expired["status"], expired["control_allowed"]) == ("EXPIRED", False)
    assert expired["inhibitions"] == ["expired"]
    assert expired["control_allowed_axes"] == {"yaw": False, "roll": False, "pitch": False}
    assert expired["yaw_deg"] == 0.1, "the angle stays readable"
    (kept,) = (await bench.get("/attitude/history"))["rows"]
    assert kept["status"] == "ACQUIRED", "history is not rewritten"
    bench.clock.data[make.sc] = make.now_us
    assert (await bench.get("/attitude"))["status"] == "ACQUIRED"


async def test_history_pages_meet_without_hole_or_overlap(bench, make):
    epochs_us = [make.now_us + k * 60 * make.s for k in range(7)]
    rows = bench.append(epochs_us)
    bench.consume([Outcome((make.row(row),), None) for row in rows])
    seen, cursor = [], None
    while True:
        answer = await bench.client.get(
            f"{bench.url}/attitude/history", params={"limit": 3, **({"cursor": cursor} if cursor else {})}
        )
        page = answer.json()
        seen += [row["epoch"] for row in page["rows"]]
        cursor = page["next"]
        assert ('rel="next"' in answer.headers.get("link", "")) == (cursor is not None)
        if cursor is None:
            break
    assert seen == [format_epoch(epoch_us) for epoch_us in epochs_us]
    assert all(early < late for early, late in pairwise(seen))
    part = await bench.get(
        "/attitude/history", start=format_epoch(epochs_us[1]), stop=format_epoch(epochs_us[3]), method="paper"
    )
    assert [row["epoch"] for row in part["rows"]] == seen[1:3], "start inclusive, stop exclusive"
    assert part["range"] == {"start": seen[1], "stop": seen[3]}
    assert (part["method"], part["version"], part["next"]) == ("paper", "live", None)


async def test_versions_are_apart(bench, make):
    (row,) = bench.append([make.now_us])
    bench.consume([Outcome((make.row(row),), make.command(row))])
    version = bench.replay()
    replayed = make.row(row, residual_rms_db=0.25)
    bench.storage.results.save_outcomes(make.sc, version, [Outcome((replayed,), make.command(row))], 0, None)
    (live,) = (await bench.get("/attitude/history"))["rows"]
    (again,) = (await bench.get("/attitude/history", version=version))["rows"]
    assert again == live | {"residual_rms_db": 0.25, "version": version}
    assert len((await bench.get("/torques/history", version=version))["rows"]) == 1
    assert repr(bench.storage.results.newest_attitude(make.sc, LIVE, Method.PAPER)) == repr(make.row(row))
