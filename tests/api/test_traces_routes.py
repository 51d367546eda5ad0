"""Evidence traces: sent by front ends, listed, read as JSON or CSV, in a ring a source."""

import json
from typing import Any

import pytest
from role_keys import RoleKeys

from service.api.problems.next_steps import NEXT_STEPS
from service.records.epoch import format_epoch

pytestmark = pytest.mark.anyio
URL = "/api/v1/spacecraft/yamal-202/traces"
NOW_US = 1_795_230_000_000_000


def trace(offset_s: float = 0.0, **changes: Any) -> dict[str, Any]:
    """A short trace so many seconds after the present."""
    return {
        "epoch": format_epoch(NOW_US + round(offset_s * 1e6)),
        "sweep": "tp1",
        "start_hz": 954e6,
        "step_hz": 15e3,
        "rbw_hz": 30e3,
        "enbw_hz": 31.5e3,
        "sweep_time_s": 2.0,
        "power_dbm": [-91.25, None, -60.1],
        **changes,
    }


async def send(soo, *traces: dict[str, Any], source: str = "sa-1") -> dict[str, Any]:
    answer = await soo.client.post(URL, json={"source": source, "traces": list(traces)})
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


@pytest.fixture
async def record(soo, spacecraft, carriers):
    await soo.with_plan(spacecraft, carriers)
    return soo


async def test_a_trace_is_kept_once_listed_and_read(record):
    assert await send(record, trace(-2)) == {
        "received": 1,
        "accepted": 1,
        "duplicates": 0,
        "dropped": 0,
        "refused": [],
    }
    assert (await send(record, trace(-2), trace(-1)))["duplicates"] == 1
    page = (await record.client.get(URL)).json()
    assert [row["epoch"] for row in page["rows"]] == [format_epoch(NOW_US - s * 1_000_000) for s in (2, 1)]
    head = page["rows"][0]
    assert {name: head[name] for name in ("source", "sweep", "points", "start_hz", "step_hz", "enbw_hz")} == {
        "source": "sa-1",
        "sweep": "tp1",
        "points": 3,
        "start_hz": 954e6,
        "step_hz": 15e3,
        "enbw_hz": 31.5e3,
    }
    assert "power_dbm" not in head
    read = await record.client.get(f"{URL}/{head['epoch']}")
    assert read.json() == {**head, "power_dbm": [-91.25, None, -60.1]}


async def test_a_trace_as_csv(record):
    await send(record, trace(-2))
    path = f"{URL}/{format_epoch(NOW_US - 2_000_000)}"
    answer = await record.client.get(path, headers={"Accept": "text/csv"})
    assert answer.headers["content-type"].startswith("text/csv")
    assert answer.headers["content-disposition"].startswith('attachment; filename="yamal-202-sa-1-tp1-')
    assert answer.text.split("\r\n") == [
        "frequency_hz,power_dbm",
        "954000000.0,-91.25",
        "954015000.0,",
        "954030000.0,-60.1",
        "",
    ]
    assert (await record.client.get(path, params={"format": "csv"})).text == answer.text


async def test_pages_and_filters(record):
    await send(record, *(trace(-k) for k in range(5, 0, -1)))
    await send(record, trace(-3, sweep="tp2"), source="sa-2")
    first = await record.client.get(URL, params={"limit": 4})
    assert 'rel="next"' in first.headers["link"]
    second = (await record.client.get(URL, params={"limit": 4, "cursor": first.json()["next"]})).json()
    assert (len(first.json()["rows"]), len(second["rows"]), second["next"]) == (4, 2, None)

    async def count(**params: Any) -> int:
        return len((await record.client.get(URL, params=params)).json()["rows"])

    assert await count(source="sa-2") == 1
    assert await count(sweep="tp1") == 5
    assert await count(start=format_epoch(NOW_US - 2_000_000), stop=format_epoch(NOW_US)) == 2
    shared = f"{URL}/{format_epoch(NOW_US - 3_000_000)}"
    ambiguous = await record.client.get(shared)
    assert (ambiguous.status_code, ambiguous.json()["code"]) == (409, "trace.ambiguous")
    assert (await record.client.get(shared, params={"sweep": "tp2"})).json()["source"] == "sa-2"


async def test_a_trace_from_the_future_cannot_push_the_others_out(record):
    receipt = await send(record, trace(-1), trace(6), trace(epoch="1999-12-31T23:59:59.000000Z"))
    assert (receipt["received"], receipt["accepted"]) == (3, 1)
    assert [(r["index"], r["code"]) for r in receipt["refused"]] == [(1, "time.future"), (2, "time.too_old")]
    assert all(r["next_step"] == NEXT_STEPS[r["code"]] for r in receipt["refused"])
    record.clock.data["yamal-202"] = None
    # nothing has moved the data clock yet: the end of the calendar is the bound
    late = await send(record, trace(50 * 365 * 86_400), trace(epoch="2101-01-01T00:00:00.000000Z"))
    assert [r["code"] for r in late["refused"]] == ["time.future"]


async def test_unknown_ones_are_404_and_a_bad_epoch_is_422(record):
    for path, status, code in (
        (f"{URL}/{format_epoch(NOW_US)}", 404, "trace.unknown"),
        (f"{URL}/yesterday", 422, "epoch.malformed"),
        (URL.replace("yamal-202", "yamal-300"), 404, "spacecraft.unknown"),
    ):
        answer = await record.client.get(path)
        assert (answer.status_code, answer.json()["code"]) == (status, code)
    body = {"source": "sa-1", "traces": [trace(-1)]}
    answer = await record.client.post(URL.replace("yamal-202", "yamal-300"), json=body)
    assert (answer.status_code, answer.json()["code"]) == (404, "spacecraft.unknown")


async def test_roles(record):
    record.app.state.key_ring = RoleKeys()
    body = {"source": "sa-1", "traces": [trace(-1)]}
    for role, status in (("viewer", 403), ("station", 200)):
        answer = await record.client.post(URL, json=body, headers={"Authorization": f"Bearer {role}"})
        assert answer.status_code == status
    assert (await record.client.get(URL, headers={"Authorization": "Bearer viewer"})).status_code == 200


POWER = "/traces/0/power_dbm"
BAD = [
    ("no source", {"traces": []}, "field.missing", "/source"),
    ("unknown field", {"source": "s", "traces": [trace(detector="RMS")]}, "field.unknown", "/traces/0/detector"),
    ("no points", {"source": "s", "traces": [trace(power_dbm=[])]}, "value.length", POWER),
    ("text", {"source": "s", "traces": [trace(power_dbm=["-1"])]}, "value.type", f"{POWER}/0"),
    ("step", {"source": "s", "traces": [trace(step_hz=0)]}, "value.range", "/traces/0/step_hz"),
    ("epoch", {"source": "s", "traces": [trace(epoch="now")]}, "epoch.malformed", "/traces/0/epoch"),
    ("sweep", {"source": "s", "traces": [trace(sweep="a/b")]}, "value.pattern", "/traces/0/sweep"),
    ("many", {"source": "s", "traces": [trace(power_dbm=[1])] * 257}, "value.length", "/traces"),
    ("long", {"source": "s", "traces": [trace(power_dbm=[1] * 100_002)]}, "body.too_large", None),
]


@pytest.mark.parametrize(("body", "code", "pointer"), [c[1:] for c in BAD], ids=[c[0] for c in BAD])
async def test_bad_traces_are_refused_whole(record, body, code, pointer):
    answer = await record.client.post(URL, content=json.dumps(body))
    problem = answer.json()
    assert problem["code"] == code, problem
    if pointer is not None:
        assert (answer.status_code, problem["errors"][0]["pointer"]) == (422, pointer)
    assert (await record.client.get(URL)).json()["rows"] == []


async def test_nan_tokens_are_refused(record):
    text = json.dumps({"source": "s", "traces": [trace(power_dbm=["@"])]}).replace('"@"', "NaN")
    answer = await record.client.post(URL, content=text)
    assert (answer.status_code, answer.json()["errors"][0]["code"]) == (422, "value.not_finite")
