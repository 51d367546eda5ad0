"""Calibrations, alignments, jobs, replays: shapes and steps over stored figures, and methods that are refused."""

import asyncio

import pytest
from role_keys import RoleKeys

from service.ports.archive import Outcome
from service.records.epoch import format_epoch
from service.records.levels.attitude import Axes
from service.records.operations.access import Role
from service.records.operations.work import JobState
from service.runtime.jobs.replay import Replayer

pytestmark = pytest.mark.anyio


SC = "/spacecraft/yamal-202"
QUIET = {"start": "2026-11-17T03:00:00Z", "stop": "2026-11-19T03:00:00Z"}
TURNS = {"start": "2026-11-19T03:00:00Z", "stop": "2026-11-20T03:00:00Z"}
ASKED = {"quiet": QUIET, "turns": TURNS, "method": "paper"}
MANUAL = {
    "epoch": "2026-11-21T03:00:00Z",
    "yaw_deg": 0.5,
    "roll_deg": 0.0,
    "pitch_deg": -0.1,
    "sigma_deg": {"yaw": 0.1, "roll": 0.02, "pitch": 0.02},
    "source": "manual",
}


async def job_of(bench, job: str) -> dict:
    """Return a job that has ended."""
    while True:
        answer = (await bench.client.get(f"/api/v1/jobs/{job}")).json()
        if answer["state"] in {"done", "failed"}:
            return answer
        await asyncio.sleep(0.01)


async def test_figures_of_a_calibration_are_told_by_name(bench, make):
    carrier = make.carrier_calibration(
        0,
        Axes(0.11, 1.9, -0.4),
        sensitivity_plus_db_per_deg=Axes(0.12, 1.8, make.nan),
        axis_ratio=float("inf"),
        rejected_because=("no dominant axis: ratio 1.10",),
        selected=False,
    )
    bench.calibrate([carrier])
    reported = await bench.get("/calibrations/1")
    assert reported == {
        "id": 1,
        "plan_id": 1,
        "ephemeris_id": 1,
        "state": "active",
        "method": "paper",
        "quiet": {"start": "2026-11-21T02:59:59.999990Z", "stop": "2026-11-21T03:00:00.000000Z"},
        "turns": {"start": "2026-11-21T03:00:00.000000Z", "stop": "2026-11-21T03:00:00.000010Z"},
        "sources": {"yaw": "radio_beacon", "roll": "star_tracker", "pitch": "star_tracker"},
        "created_at": "2026-11-21T03:00:00.000000Z",
        "created_by": "engineer",
        "error": None,
        "override_reason": None,
        "quality": {
            "quiet_rows": 2880.0,
            "turn_reach_deg": None,
            "yaw_sign": "not_judged",
            "common_sign": "not_judged",
            "momentum": "not_stated",
            "polarimeter": "not_stated",
            "rates": "not_stated",
            "turns": "not_checked",
            "warnings": ["few turns"],
        },
        "observability": {
            "condition": 9.5,
            "dop": {"yaw": 4.0, "roll": 0.5, "pitch": 0.6},
            "crlb_deg": {"yaw": None, "roll": 0.02, "pitch": 0.03},
        },
        "job": None,
        "carriers": [
            {
                "id": "c00",
                "level_dbm": -42.0,
                "sigma_white_db": 0.03,
                "noise": [{"correlation_time_s": 1200.0, "sigma_db": 0.04}],
                "harmonic": {
                    "amplitude_db": 0.35,
                    "phase_rad": -0.6,
                    "offset_dbm": -42.0,
                    "period_s": 86328.0,
                    "node_epoch": "2026-11-20T02:00:00.000000Z",
                    "rms_db": 0.05,
                    "samples_used": 2800,
                    "samples_rejected": 12,
                },
                "sensitivity_db_per_deg": {"yaw": 0.11, "roll": 1.9, "pitch": -0.4},
                "sensitivity_plus_db_per_deg": {"yaw": 0.12, "roll": 1.8, "pitch": None},
                "sensitivity_minus_db_per_deg": {"yaw": 0.11, "roll": 1.9, "pitch": -0.4},
                "residual_db": 0.06,
                "stability": {"residual_rms_db": 0.05, "drift_db_per_day": None},
                "linearity": {"deviation_at_0p5_deg_db": 0.02, "departure_deg": 0.03, "range_deg": 0.5},
                "axis": "roll",
                "axis_ratio": None,
                "criteria_met": ["stable", "linear", "dominant"],
                "rejected_because": ["no dominant axis: ratio 1.10"],
                "selected": False,
            }
        ],
    }
    assert (await bench.get("/calibrations"))["rows"] == [reported]


async def test_calibration_without_data_fails_with_a_reason(bench):
    answer = await bench.client.post(f"/api/v1{SC}/calibrations", json=ASKED)
    assert answer.status_code == 202, answer.text
    assert answer.headers["location"] == f"/api/v1{SC}/calibrations/1"
    started = answer.json()
    assert started.keys() == {"id", "job"}
    job = await job_of(bench, started["job"])
    assert (job["state"], job["progress"], job["kind"]) == ("failed", 1.0, "calibration")
    assert "quiet window" in job["error"]
    failed = await bench.get("/calibrations/1")
    assert (failed["state"], failed["observability"], failed["carriers"]) == ("failed", None, [])
    assert failed["quality"] == {"warnings": []}
    assert failed["error"] == job["error"]
    assert failed["sources"] == {"yaw": "star_tracker", "roll": "star_tracker", "pitch": "star_tracker"}
    assert failed["created_by"] == "bootstrap"
    refusal = await bench.refused("POST", f"{SC}/calibrations/1:activate")
    assert refusal == (409, "calibration.unfinished", [])


async def test_a_window_whose_rows_do_not_fit_the_memory_is_refused(bench):
    long = {"start": "2026-01-01T00:00:00Z", "stop": "2026-04-12T00:00:00Z"}
    for name in ("quiet", "turns"):
        refusal = await bench.refused("POST", f"{SC}/calibrations", json=ASKED | {name: long})
        assert refusal[:2] == (422, "range.too_long")
    assert (await bench.get("/calibrations"))["rows"] == []


async def test_sources_of_each_axis_are_kept(bench):
    sources = {"yaw": "radio_beacon", "roll": "earth_sensor", "pitch": "other"}
    started = (await bench.client.post(f"/api/v1{SC}/calibrations", json=ASKED | {"sources": sources})).json()
    assert (await bench.get(f"/calibrations/{started['id']}"))["sources"] == sources
    await job_of(bench, started["job"])


async def test_activation_supersedes_the_one_before(bench, make):
    for _ in range(2):
        bench.calibrate([make.carrier_calibration(0, Axes(0.1, 1.0, 0.2))], is_active=False)
    for number in (1, 2, 2):
        answer = await bench.client.post(f"{bench.url}/calibrations/{number}:activate")
        assert (answer.status_code, answer.json()["state"]) == (200, "active"), answer.text
    states = [row["state"] for row in (await bench.get("/calibrations"))["rows"]]
    assert states == ["active", "superseded"], "newest first"


async def test_alignment_is_told_field_by_field(bench, make):
    bench.calibrate([make.carrier_calibration(0, Axes(0.1, 1.0, 0.2))])
    bench.align(make.now_us)
    reported = await bench.get("/alignments/1")
    assert reported == {
        "id": 1,
        "epoch": format_epoch(make.now_us),
        "yaw_deg": 0.1,
        "roll_deg": 0.0,
        "pitch_deg": -0.1,
        "sigma_deg": {"yaw": None, "roll": 0.01, "pitch": 0.01},
        "calibration_id": 1,
        "source": "star_tracker",
        "window": {"start": "2026-11-21T02:45:00.000000Z", "stop": "2026-11-21T03:00:00.000001Z"},
        "override_reason": None,
        "created_at": format_epoch(make.now_us),
        "created_by": "approver",
        "references": [
            {
                "carrier": "c00",
                "reference_dbm": -42.1,
                "sigma_db": 0.01,
                "samples": 15,
                "change_since_calibration_db": None,
            }
        ],
        "references_by_method": {},
        "calibration_by_method": {},
        "changed_carriers": [],
        "warnings": [],
    }
    bench.align(make.now_us + 1)
    assert [row["id"] for row in (await bench.get("/alignments"))["rows"]] == [2, 1], "newest first"


async def test_alignment_says_what_it_lacks(bench, make):
    window = {"start": "2026-11-21T02:00:00Z", "stop": "2026-11-21T03:00:00Z", "source": "earth_sensor"}
    assert await bench.refused("POST", f"{SC}/alignments", json=window) == (409, "alignment.no_calibration", [])
    bench.calibrate([make.carrier_calibration(0, Axes(0.1, 1.0, 0.2))])
    assert await bench.refused("POST", f"{SC}/alignments", json=window) == (422, "alignment.no_reference", [])
    assert await bench.refused("POST", f"{SC}/alignments", json=MANUAL) == (422, "alignment.no_powers", [])


async def test_angles_by_hand_need_an_approver(bench):
    for role, expected in (
        (Role.VIEWER, (403, "key.forbidden")),
        (Role.OPERATOR, (403, "key.forbidden")),
        (Role.APPROVER, (409, "alignment.no_calibration")),
    ):
        bench.app.state.key_ring = RoleKeys(role)
        assert (await bench.refused("POST", f"{SC}/alignments", json=MANUAL))[:2] == expected, role


async def test_only_so_many_replays_wait_at_once(bench, make):
    """40 of them were 40 times 202."""
    bench.jobs.stop()
    object.__setattr__(bench.context, "replayer", Replayer(bench.storage, bench.clock, bench.jobs.notify, 3))
    bench.calibrate([make.carrier_calibration(0, Axes(0.1, 1.0, 0.2))])
    bench.align(make.now_us)
    span = {"start": "2026-11-21T02:00:00Z", "stop": "2026-11-21T04:00:00Z"}
    answers = await asyncio.gather(*(bench.client.post(f"{bench.url}/replays", json=span) for _ in range(40)))
    assert sorted(answer.status_code for answer in answers) == [202] * 3 + [429] * 37
    busy = next(answer for answer in answers if answer.status_code == 429)
    assert (busy.json()["code"], busy.headers["retry-after"]) == ("replay.busy", "5")
    while bench.jobs.poll_once():
        pass
    for started in (answer for answer in answers if answer.status_code == 202):
        assert (await job_of(bench, started.json()["job"]))["state"] == "done"
    assert (await bench.client.post(f"{bench.url}/replays", json=span)).status_code == 202


async def test_replay_needs_an_alignment(bench, make):
    span = {"start": "2026-11-21T02:00:00Z", "stop": "2026-11-21T04:00:00Z"}
    assert await bench.refused("POST", f"{SC}/replays", json=span) == (409, "replay.not_aligned", [])
    bench.calibrate([make.carrier_calibration(0, Axes(0.1, 1.0, 0.2))], is_active=False)
    bench.align(make.now_us)
    assert await bench.refused("POST", f"{SC}/replays", json=span | {"alignment_id": 7}) == (
        404,
        "alignment.unknown",
        [],
    )
    answer = await bench.client.post(f"/api/v1{SC}/replays", json=span | {"order": "epoch", "method": "paper"})
    assert answer.status_code == 202, answer.text
    started = answer.json()
    assert (started["id"], started["version"]) == (1, "replay-1")
    assert answer.headers["location"] == f"/api/v1{SC}/replays/1"
    assert (await job_of(bench, started["job"]))["state"] == "done"
    assert await bench.get("/replays/1") == started | {
        "start": "2026-11-21T02:00:00.000000Z",
        "stop": "2026-11-21T04:00:00.000000Z",
        "method": "paper",
        "calibration_id": None,
        "alignment_id": 1,
        "order": "epoch",
        "commands": True,
        "smooth": False,
        "created_at": format_epoch(make.now_us),
        "state": "done",
        "progress": 1.0,
        "error": None,
        "attitude_rows": 0,
        "torque_rows": 0,
        "size_bytes": 0,
    }
    assert (await bench.get("/attitude/history", version="replay-1"))["rows"] == []


async def test_only_the_robust_method_has_smoothed_rows(bench, make):
    span = {"start": "2026-11-21T00:00:00Z", "stop": "2026-11-22T00:00:00Z"}
    for body, words in (
        ({"smooth": True, "method": "paper"}, "only the robust method has smoothed rows"),
        ({"smooth": True, "method": "robust_smoothed"}, "run on no measurement and drive no control"),
        ({"smooth": "often"}, "smooth"),
    ):
        answer = await bench.client.post(f"{bench.url}/replays", json=span | body)
        assert (answer.status_code, answer.headers["content-type"]) == (422, "application/problem+json")
        assert words in answer.text


async def test_a_replay_says_whether_it_smooths(bench, make):
    bench.calibrate([make.carrier_calibration(k, Axes(0.1 * k * k, 1.0, 0.5 * k)) for k in range(6)])
    bench.align(bench.append([make.now_us - 60 * make.s])[0].epoch_us)
    span = {"start": format_epoch(make.now_us - 600 * make.s), "stop": format_epoch(make.now_us)}
    for smooth in (True, False):
        answer = await bench.client.post(f"{bench.url}/replays", json={**span, "smooth": smooth})
        assert answer.status_code == 202, answer.text
        reported = await bench.get(f"/replays/{answer.json()['id']}")
        assert (reported["smooth"], reported["method"]) == (smooth, None)


async def test_live_rows_are_never_smoothed_ones(bench, make):
    bench.append([make.now_us - 60 * make.s])
    of_samples = "samples?quantity=roll_deg"
    for path in ("attitude", "attitude/history", "archive/attitude:export?format=csv", "timeline", of_samples):
        query = f"{'&' if '?' in path else '?'}method=robust_smoothed"
        answer = await bench.client.get(f"{bench.url}/{path}{query}")
        assert answer.status_code == 422, (path, answer.text)
        assert answer.json()["code"] == "method.smoothed", path
    version = bench.replay()
    history = await bench.get("/attitude/history", version=version, method="robust_smoothed")
    assert (history["method"], history["rows"]) == ("robust_smoothed", [])


async def test_versions_are_listed_with_their_sizes_page_by_page(bench, make):
    versions = [bench.replay() for _ in range(3)]
    (row,) = bench.append([make.now_us - 60 * make.s])
    bench.storage.results.save_outcomes(make.sc, versions[1], [Outcome((make.row(row),), None)], 0, None)
    first = await bench.get("/replays", limit=2)
    second = await bench.get("/replays", limit=2, cursor=first["next"])
    listed = first["rows"] + second["rows"]
    assert [each["version"] for each in listed] == versions
    assert second["next"] is None
    assert [each["attitude_rows"] for each in listed] == [0, 1, 0]
    assert listed[1]["size_bytes"] == 320
    assert {each["state"] for each in listed} == {"done"}
    assert await bench.get(f"/replays/{listed[1]['id']}") == listed[1]


async def test_a_deleted_version_is_unknown_to_everybody(bench):
    version = bench.replay()
    path = f"{bench.url}/replays/{version.removeprefix('replay-')}"
    assert (await bench.client.delete(path)).status_code == 204
    span = {"start": "2026-01-01T00:00:00Z", "stop": "2030-01-01T00:00:00Z"}
    asked = [
        await bench.client.delete(path),
        await bench.client.get(path),
        await bench.client.get(f"{bench.url}/attitude/history", params={**span, "version": version}),
        await bench.client.get(
            f"{bench.url}/archive/attitude:export", params={**span, "format": "csv", "version": version}
        ),
    ]
    assert {(each.status_code, each.json()["code"]) for each in asked} == {(404, "replay.unknown")}
    assert (await bench.get("/replays"))["rows"] == []


async def test_rows_of_a_version_that_is_not_complete_are_not_given(bench, make):
    reasons = {JobState.QUEUED: "is queued", JobState.RUNNING: "running (50%)", JobState.FAILED: "the disk was full"}
    for state, text in reasons.items():
        version = bench.replay(state, 0.5, "the disk was full")
        for path in ("attitude/history", "torques/history", "archive/attitude:export"):
            answer = await bench.client.get(f"{bench.url}/{path}", params={"version": version})
            assert (answer.status_code, answer.json()["code"]) == (409, "replay.unfinished"), path
            assert text in answer.json()["detail"]
