"""Attitude and measurements on their way out: newest, history, validity, status, smoothed rows, carriers left out."""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from served_stream import Reader, Served, serving

from service.ports.archive import LIVE, SMOOTHED, Outcome
from service.records.catalogue import Method
from service.records.epoch import format_epoch
from service.records.levels.attitude import NO_ANGLES, Axes, CarrierResults, Exclusion, Status
from service.records.levels.measurement import CarrierDetails

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


async def test_rate_and_time_to_the_limit_are_the_same_in_every_answer_and_those_of_the_drift(bench, make):
    epochs_us = [make.now_us + k * 60 * make.s for k in range(41)]
    rows = bench.append(epochs_us)
    # pitch begins to turn by 0.6 deg/h when half an hour is left, roll the other way; the estimator shows none of it
    turned_deg = [0.6 * max(0, k - 10) / 60.0 for k in range(41)]
    drift = [Axes(0.05, 0.02 - angle, angle) for angle in turned_deg]
    still = Axes(0.0, 0.0, 0.0)
    told = [make.row(row, attitude_deg=angles, rates_deg_s=still) for row, angles in zip(rows, drift, strict=True)]
    bench.consume([Outcome((row,), None) for row in told])
    bench.clock.system = epochs_us[-1]
    answers = [(await bench.get(path))["control"] for path in ("/status", "/attitude", "/control", "/torques")]
    answers.append((await bench.get("/handover"))["control"])
    axes = answers[0]["situation"]["axes"]
    assert [answer["situation"] for answer in answers] == [answers[0]["situation"]] * 5
    yaw, roll, pitch = axes
    assert (yaw["axis"], yaw["rate_deg_h"], yaw["hours_to_limit"]) == ("yaw", pytest.approx(0.0, abs=1e-9), None)
    assert (roll["rate_deg_h"], pitch["rate_deg_h"]) == (pytest.approx(-0.6), pytest.approx(0.6))
    assert roll["hours_to_limit"] == pytest.approx((0.4 - 0.28) / 0.6)
    assert pitch["hours_to_limit"] == pytest.approx((0.4 - 0.3) / 0.6)
    worst = answers[0]["situation"]
    assert (worst["code"], worst["axis"], worst["angle_deg"]) == ("towards_limit", "pitch", pytest.approx(0.3))
    assert (worst["rate_deg_h"], worst["hours_to_limit"]) == (pitch["rate_deg_h"], pitch["hours_to_limit"])
    # half an hour later the row is no present: angles stay, rates do not
    bench.clock.system += 1800 * make.s
    old = (await bench.get("/status"))["control"]["situation"]
    assert (old["code"], [each["angle_deg"] for each in old["axes"]]) == ("old", [each["angle_deg"] for each in axes])
    assert [each["rate_deg_h"] for each in old["axes"] + old["axes"]] == [None] * 6


async def test_a_commanded_turn_is_over_when_it_is_executed(bench, make):
    """For half an hour after it the slope of all rows says that the angle goes on to its limit."""
    epochs_us = [make.now_us + k * 60 * make.s for k in range(41)]
    rows = bench.append(epochs_us)
    body = {"start": format_epoch(epochs_us[10]), "stop": format_epoch(epochs_us[20]), "pitch_deg": 0.3}
    assert (await bench.client.post(f"{bench.url}/corrections:batch", json={"corrections": [body]})).is_success
    angles = [Axes(0.05, 0.02, 0.3 * min(max(k - 10, 0), 10) / 10.0) for k in range(41)]
    outcomes = [Outcome((make.row(row, attitude_deg=each),), None) for row, each in zip(rows, angles, strict=True)]
    bench.consume(outcomes)
    bench.clock.system = epochs_us[-1]
    situation = (await bench.get("/status"))["control"]["situation"]
    assert [each["rate_deg_h"] for each in situation["axes"]] == pytest.approx([0.0] * 3, abs=1e-9)
    assert situation["code"] == "known"


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


OF_SERIES = {"version": SMOOTHED, "method": "robust_smoothed"}


@pytest.fixture
def served(bench, make) -> Iterator[Served]:
    with serving(bench.app, make.key) as served:
        yield served


@pytest.fixture
def store(bench, make):
    """Return what stores smoothed rows of measurements some minutes old."""

    def store(*minutes):
        rows = bench.append([make.now_us - minute * 60 * make.s for minute in minutes])
        made = [
            replace(make.row(row, method=Method.ROBUST_SMOOTHED), lag_s=7200.0, control_allowed=False) for row in rows
        ]
        outcomes = [Outcome((row,), None) for row in made]
        bench.storage.results.save_outcomes(make.sc, SMOOTHED, outcomes, 0, None)
        return made

    return store


async def test_the_series_is_listed_page_by_page_in_both_orders(bench, store):
    assert (await bench.get("/attitude/smoothed"))["rows"] == []
    made = store(30, 25, 20)
    first = await bench.get("/attitude/smoothed", limit=2)
    rest = await bench.get("/attitude/smoothed", limit=2, cursor=first["next"])
    rows = first["rows"] + rest["rows"]
    assert (len(first["rows"]), rest["next"]) == (2, None)
    assert [row["roll_deg"] for row in rows] == [row.attitude_deg.roll for row in made]
    assert {(row["method"], row["version"], row["lag_s"]) for row in rows} == {("robust_smoothed", SMOOTHED, 7200.0)}
    assert not any(row["control_allowed"] for row in rows)
    assert (first["method"], first["version"]) == ("robust_smoothed", SMOOTHED)
    backward = await bench.get("/attitude/smoothed", order="desc")
    assert backward["rows"] == rows[::-1]
    # the same rows under the general names
    assert (await bench.get("/attitude/history", **OF_SERIES))["rows"] == rows


async def test_samples_and_exports_have_them(bench, store):
    made = store(30, 25, 20)
    samples = await bench.get("/samples", quantity="roll_deg", count=10, **OF_SERIES)
    assert "robust_smoothed" in str(samples)
    answer = await bench.client.get(f"{bench.url}/archive/attitude:export", params={"format": "csv", **OF_SERIES})
    assert answer.status_code == 200, answer.text
    lines = [line for line in answer.text.splitlines() if line and not line.startswith("#")]
    assert len(lines) == len(made) + 1
    assert "attitude_robust_smoothed_smoothed" in answer.headers["content-disposition"]


async def test_nothing_of_the_present_is_touched(bench, make, store):
    before = await bench.get("/attitude")
    head = bench.storage.archive.head(make.sc)
    made = store(30)
    assert bench.storage.archive.head(make.sc).result_sequence == head.result_sequence
    after = await bench.get("/attitude")
    assert (after["method"], after["version"]) == (before["method"], before["version"])
    assert after["control"]["allowed"] is before["control"]["allowed"]
    assert (await bench.get("/torques/history", version=SMOOTHED))["rows"] == []
    assert len(made) == 1


@pytest.mark.parametrize(
    ("path", "own"),
    [
        ("attitude/history", {}),
        ("archive/attitude:export", {"format": "csv"}),
        ("samples", {"quantity": "roll_deg"}),
    ],
)
async def test_other_methods_have_no_rows_in_it(bench, store, path, own):
    store(30)
    for method in ("robust", "paper"):
        query = {"version": SMOOTHED, "method": method, **own}
        answer = await bench.client.get(f"{bench.url}/{path}", params=query)
        assert (answer.status_code, answer.json()["code"]) == (422, "method.smoothed"), path
        assert "has rows of method robust_smoothed alone" in answer.text


async def test_the_stream_sends_each_new_row_as_the_list_has_it(served, bench, store):
    store(40)
    with served.open(None, "status", "smoothed") as response:
        reader = Reader(response)
        # what there is at the first look is no change
        reader.consume(1, "status")
        store(35, 30)
        events = reader.consume(2)
    rows = (await bench.get("/attitude/smoothed"))["rows"]
    assert [event.kind for event in events] == ["smoothed", "smoothed"]
    assert [event.data for event in events] == rows[1:]


@pytest.mark.parametrize("methods", [("paper",), ("paper", "robust"), ()])
async def test_rows_are_pending_until_the_chain_has_consumed_them(bench, make, methods):
    bench.calibrate([make.carrier_calibration(k, Axes(0.1 * k * k, 1.0, 0.5 * k)) for k in range(6)])
    first = bench.align(make.now_us - 600 * make.s)
    named = dict.fromkeys(methods, first.calibration_id)
    bench.storage.results.add_alignment(make.sc, replace(first, calibration_by_method=named))
    rows = bench.append([make.now_us - (3 - k) * 60 * make.s for k in range(3)])
    assert (await bench.get("/status"))["pending"] == 3
    bench.consume([Outcome((make.row(row), make.row(row, method=Method.ROBUST)), None) for row in rows])
    assert (await bench.get("/status"))["pending"] == 0


async def test_nothing_is_pending_before_an_alignment(bench, make):
    bench.append([make.now_us])
    status = await bench.get("/status")
    assert (status["pending"], status["aligned"], status["realignment_advised"]) == (0, False, False)


def results_of(plan_id, carriers):
    levels_db = np.linspace(-0.5, 0.5, carriers)
    levels_db[1] = np.nan
    codes = np.arange(carriers) % 5
    return CarrierResults(plan_id, levels_db, levels_db / 2, codes, codes)


async def test_rows_tell_state_reason_and_levels(bench, make):
    rows = bench.append([make.now_us - seconds * make.s for seconds in (90, 60, 30)])
    carriers = len(rows[0].power_dbm)
    known = results_of(rows[0].plan_id, carriers)
    outcomes = [
        Outcome((make.row(row),), None, carriers=() if position == 1 else (known,)) for position, row in enumerate(rows)
    ]
    bench.consume(outcomes)
    page = await bench.get("/carriers/c02/results", method="paper")
    assert (page["carrier"], page["method"], page["version"], page["next"]) == ("c02", "paper", "live", None)
    first, without, last = page["rows"]
    assert first == {
        "epoch": "2026-11-21T02:58:30.000000Z",
        "state": "excluded",
        "reason": None,
        "deviation_db": pytest.approx(known.deviation_db[2], abs=0.003),
        "residual_db": pytest.approx(known.residual_db[2], abs=0.003),
        "hypothesis": "wet",
        "plan_id": rows[0].plan_id,
    }
    assert {**last, "epoch": first["epoch"]} == first
    assert [without[name] for name in ("state", "deviation_db", "hypothesis", "plan_id")] == [None] * 4
    absent = (await bench.get("/carriers/c01/results"))["rows"][0]
    assert (absent["state"], absent["deviation_db"]) == ("absent", None)
    assert (await bench.get("/carriers/c03/results"))["rows"][0]["reason"] == "uplink_fade"
    robust = await bench.get("/carriers/c02/results", method="robust")
    assert {row["state"] for row in robust["rows"]} == {None}
    # sealed it is the same
    list(bench.storage.results.seal(make.sc, 1 << 60))
    assert await bench.get("/carriers/c02/results", method="paper") == page


@pytest.mark.parametrize(
    "path", ["/attitude/history", "/torques/history", "/measurements/history", "/carriers/c02/results"]
)
async def test_pages_meet(bench, make, path):
    rows = bench.append([make.now_us + k * make.s for k in range(5)])
    known = results_of(rows[0].plan_id, len(rows[0].power_dbm))
    bench.consume([Outcome((make.row(row),), make.command(row), carriers=(known,)) for row in rows])
    whole = (await bench.get(path))["rows"]
    assert [row["epoch"] for row in whole] == [format_epoch(row.epoch_us) for row in rows]
    first = await bench.get(path, limit=3)
    second = await bench.get(path, limit=3, cursor=first["next"])
    assert (len(first["rows"]), first["rows"] + second["rows"], second["next"]) == (3, whole, None)


async def test_a_carrier_that_no_plan_has_is_refused(bench, make):
    bench.append([make.now_us])
    path = f"/spacecraft/{make.sc}/carriers/c99/results"
    assert await bench.refused("GET", path) == (404, "carrier.unknown", [])


async def test_newest_row_before_anything_is_calibrated(bench, make):
    assert await bench.get("/measurements") == []
    nan = math.nan
    stated = np.float32(
        [[[0.05, nan, 1, 1, 1, 1]], [[71.3, nan, 1, 1, 1, 1]], [[nan] * 6], [[-1250.5, 0.0, 1, 1, 1, 1]]]
    )
    bench.append(
        [make.now_us],
        [-42.1, nan, -43.3, -44.0, -45.0, -46.0],
        flags=(0, 16, 512, 0, 0, 0),
        details=CarrierDetails(*stated),
    )
    newest = await bench.get("/measurements")
    nobody_asked = {"hypothesis": None, "hypothesis_probability": None, "hypothesis_since": None}
    assert newest[:2] == [
        {
            "carrier": "c00",
            "epoch": format_epoch(make.now_us),
            "power_dbm": -42.1,
            "expected_dbm": None,
            "deviation_db": None,
            "residual_db": None,
            "sigma_db": None,
            "measured_sigma_db": 0.05,
            "c_n0_db_hz": 71.3,
            "occupied_bandwidth_hz": None,
            "centroid_offset_hz": -1250.5,
            "flags": 0,
            "flag_names": [],
            "state": "uncalibrated",
            **nobody_asked,
        },
        {
            "carrier": "c01",
            "epoch": format_epoch(make.now_us),
            "power_dbm": None,
            "expected_dbm": None,
            "deviation_db": None,
            "residual_db": None,
            "sigma_db": None,
            "measured_sigma_db": None,
            "c_n0_db_hz": None,
            "occupied_bandwidth_hz": None,
            "centroid_offset_hz": 0.0,
            "flags": 16,
            "flag_names": ["NO_CARRIER"],
            "state": "absent",
            **nobody_asked,
        },
    ]
    assert [row["carrier"] for row in newest] == [f"c{k:02d}" for k in range(6)]


async def test_history_tells_powers_by_carrier_under_each_plan(bench, make):
    bench.append([make.now_us], [-42.1, math.nan, -43.3, -44.0, -45.0, -46.0], flags=(1, 2, 3, 4, 5, 6))
    plan = bench.storage.catalogue.put_plan(make.sc, [make.carrier(9), make.carrier(0)], "second")
    bench.append([make.now_us + 1], [-50.5, -51.25], source="sa-2", plan_id=plan.id)
    first, second = (await bench.get("/measurements/history"))["rows"]
    assert first["power_dbm"] == {"c00": -42.1, "c01": None, "c02": -43.3, "c03": -44.0, "c04": -45.0, "c05": -46.0}
    assert first["flag_names"]["c02"] == ["CLOCK_UNSYNC", "LATE"]
    assert (first["measured_sigma_db"], second["flag_names"]) == (None, None)
    assert first["flags"] == {"c00": 1, "c01": 2, "c02": 3, "c03": 4, "c04": 5, "c05": 6}
    assert (first["source"], first["plan_id"], first["late"]) == ("sa-1", 1, False)
    assert second["power_dbm"] == {"c09": -50.5, "c00": -51.25}
    assert (second["flags"], second["plan_id"], second["feeds_estimator"]) == (None, plan.id, False)
    (only,) = (await bench.get("/measurements/history", source="sa-2"))["rows"]
    assert only == second
    chosen = (await bench.get("/measurements/history", carrier="c00"))["rows"]
    assert [row["power_dbm"] for row in chosen] == [{"c00": -42.1}, {"c00": -51.25}]


async def test_told_powers_round_to_the_stored_float32(bench, make):
    seed = 20261121
    print("seed", seed)
    sent = np.random.default_rng(seed).uniform(-120.0, 10.0, (20, 6)).astype(np.float32)
    bench.append([make.now_us + k for k in range(20)], sent)
    rows = (await bench.get("/measurements/history"))["rows"]
    reported = np.array([list(row["power_dbm"].values()) for row in rows])
    # exact: the fewest digits that name a float32 read back to it
    assert np.array_equal(reported.astype(np.float32), sent)
