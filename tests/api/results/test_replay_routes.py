"""Replays of either method are accepted; unknown ones are not."""

import asyncio

import pytest

from service.records.epoch import format_epoch
from service.records.levels.attitude import Axes

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
