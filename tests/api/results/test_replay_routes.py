"""Replays of either method are accepted; unknown ones are not."""

import asyncio

import pytest

from service.ports import Outcome
from service.records.epoch import format_epoch
from service.records.levels.attitude import Axes
from service.records.operations.job import JobState

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize("method", ["robust", "paper", None])
async def test_replay_of_a_method_is_started_and_told(bench, make, method):
    bench.calibrate([make.carrier_calibration(k, Axes(0.1 * k * k, 1.0, 0.5 * k)) for k in range(6)])
    rows = bench.append([make.now_us - (10 - k) * 60 * make.s for k in range(10)])
    bench.align(rows[0].epoch_us)
    bench.jobs.start()
    span = {"start": format_epoch(rows[1].epoch_us), "stop": format_epoch(make.now_us)}
    answer = await bench.client.post(f"{bench.url}/replays", json=span | ({} if method is None else {"method": method}))
    assert answer.status_code == 202, answer.text
    started = answer.json()
    while (state := (await bench.client.get(f"/api/v1/jobs/{started['job']}")).json())["state"] in {
        "queued",
        "running",
    }:
        await asyncio.sleep(0.01)
    assert state == state | {"state": "done", "error": None}
    reported = await bench.get(f"/replays/{started['id']}")
    assert (reported["method"], reported["version"], reported["alignment_id"]) == (method, started["version"], 1)
    history = await bench.get("/attitude/history", **span, version=started["version"], method=method or "paper")
    assert history["method"] == (method or "paper")
    assert {row["version"] for row in history["rows"]} <= {started["version"]}


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
        assert (await bench.get(f"/replays/{answer.json()['id']}"))["smooth"] is smooth


async def test_live_rows_are_never_smoothed_ones(bench, make):
    bench.append([make.now_us - 60 * make.s])
    for path in ("attitude", "attitude/history", "archive/attitude:export", "timeline", "samples"):
        answer = await bench.client.get(
            f"{bench.url}/{path}", params={"method": "robust_smoothed", "quantity": "roll_deg", "format": "csv"}
        )
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
    version = bench.replay()
    job = bench.storage.results.replay(make.sc, version).replay.job_id
    reasons = {JobState.QUEUED: "is queued", JobState.RUNNING: "running (50%)", JobState.FAILED: "the disk was full"}
    for state, text in reasons.items():
        bench.storage.results.update_job(job, state, 0.5, "the disk was full")
        for path in ("attitude/history", "torques/history", "archive/attitude:export"):
            answer = await bench.client.get(f"{bench.url}/{path}", params={"version": version})
            assert (answer.status_code, answer.json()["code"]) == (409, "replay.unfinished"), path
            assert text in answer.json()["detail"]
