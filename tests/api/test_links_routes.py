"""Links and their traces: reports of front ends, what operators see of them and want of them."""

import json
from typing import Any

import pytest

from service.api.problems.next_steps import NEXT_STEPS
from service.records.epoch import format_epoch

pytestmark = pytest.mark.anyio


LINKS = "/api/v1/links"
REPORT = "/api/v1/links:report"
NOW_US = 1_795_230_000_000_000
S = 1_000_000


def report(link_id: str = "sa-1", **changes: Any) -> dict[str, Any]:
    """A report with every field."""
    return {
        "id": link_id,
        "kind": "analyzer",
        "spacecraft_id": "yamal-202",
        "source": "sa-1",
        "state": "MEASURE",
        "detail": {"identity": "R&S, FSV-7", "settings": {"rbw_hz": 30e3}},
        "counters": {"sweeps": 17, "reconnects": 0},
        "last_good": format_epoch(NOW_US - 4 * S),
        "warnings": [{"code": "spool.full", "detail": "93 per cent", "since": format_epoch(NOW_US - 9 * S)}],
        "reset_seen": 0,
        **changes,
    }


async def send(soo, *reports: dict[str, Any]) -> Any:
    answer = await soo.client.post(REPORT, json={"links": list(reports)})
    assert answer.status_code == 200, answer.text
    return answer.json()["links"]


async def listed(soo, **params: Any) -> list[dict[str, Any]]:
    answer = await soo.client.get(LINKS, params=params)
    assert answer.status_code == 200, answer.text
    rows: list[dict[str, Any]] = answer.json()["links"]
    return rows


async def test_a_report_is_answered_with_what_is_wanted_and_listed(soo):
    assert await listed(soo) == []
    assert await send(soo, report()) == [{"id": "sa-1", "enabled": True, "reset": 0}]
    soo.clock.system = NOW_US + 6 * S
    assert await listed(soo) == [
        {
            "id": "sa-1",
            "kind": "analyzer",
            "spacecraft_id": "yamal-202",
            "source": "sa-1",
            "state": "MEASURE",
            "reported_state": "MEASURE",
            "enabled": True,
            "reported_at": format_epoch(NOW_US),
            "age_s": 6.0,
            "period_s": 60.0,
            "last_good": format_epoch(NOW_US - 4 * S),
            "last_good_age_s": 10.0,
            "counters": {"sweeps": 17, "reconnects": 0},
            "detail": {"identity": "R&S, FSV-7", "settings": {"rbw_hz": 30e3}},
            "warnings": [{"code": "spool.full", "detail": "93 per cent", "since": format_epoch(NOW_US - 9 * S)}],
            "reset_pending": False,
            "rows_missing": None,
        }
    ]
    assert (await soo.client.get(f"{LINKS}/sa-1")).json() == (await listed(soo))[0]


async def test_the_newest_good_row_is_as_old_as_the_clock_of_its_epoch_says(soo, spacecraft):
    await soo.client.post("/api/v1/spacecraft", json=spacecraft)
    day_us = 86_400 * S
    # a simulated spacecraft lives fifteen days behind the service
    soo.clock.data["yamal-202"] = NOW_US - 15 * day_us + 60 * S
    behind = format_epoch(NOW_US - 15 * day_us)
    front = report("front-1", kind="front_end", spacecraft_id=None, source=None)
    await send(soo, report(last_good=behind), front, report("lost", spacecraft_id="nobody", last_good=None))
    soo.clock.system = NOW_US + 6 * S
    ages = {link["id"]: (link["age_s"], link["last_good_age_s"]) for link in await listed(soo)}
    assert ages == {"sa-1": (6.0, 60.0), "front-1": (6.0, 10.0), "lost": (6.0, None)}


async def test_a_link_that_reports_no_more_is_silent_and_says_since_when(soo):
    await send(soo, report(period_s=10))
    soo.clock.system = NOW_US + 30 * S
    assert (await listed(soo))[0]["state"] == "MEASURE"
    soo.clock.system = NOW_US + 31 * S
    (reported,) = await listed(soo)
    assert (reported["state"], reported["reported_state"], reported["age_s"]) == ("SILENT", "MEASURE", 31.0)
    await send(soo, report(period_s=10))
    assert (await listed(soo))[0]["state"] == "MEASURE"


async def test_a_link_that_was_ended_in_good_order_is_stopped_not_silent(soo):
    await send(soo, report(period_s=10, state="STOPPED"))
    soo.clock.system = NOW_US + 3600 * S
    assert (await listed(soo))[0]["state"] == "STOPPED"


async def test_operators_enable_disable_and_reset_and_the_next_report_hears_of_it(soo):
    await send(soo, report(), report("front-1", kind="front_end"))
    disabled = await soo.client.post(f"{LINKS}/sa-1:disable")
    reset = await soo.client.post(f"{LINKS}/sa-1:reset")
    assert (disabled.status_code, disabled.json()["enabled"]) == (200, False)
    assert (reset.json()["enabled"], reset.json()["reset_pending"]) == (False, True)
    audited = [
        (each.audit_event.who, each.audit_event.action, each.audit_event.target) for each in soo.storage.audit.chain()
    ]
    assert audited == [
        ("bootstrap", "disable_link", "/links/sa-1:disable"),
        ("bootstrap", "reset_link", "/links/sa-1:reset"),
    ]
    assert await send(soo, report(), report("front-1", kind="front_end")) == [
        {"id": "sa-1", "enabled": False, "reset": 1},
        {"id": "front-1", "enabled": True, "reset": 0},
    ]
    assert not (await listed(soo))[1]["enabled"]
    await send(soo, report(reset_seen=1))
    assert not (await soo.client.post(f"{LINKS}/sa-1:enable")).json()["reset_pending"]
    assert (await send(soo, report(reset_seen=1)))[0] == {"id": "sa-1", "enabled": True, "reset": 1}


async def test_links_of_one_spacecraft_and_a_removed_one(soo):
    await send(soo, report(), report("other", spacecraft_id="yamal-300"), report("none", spacecraft_id=None))
    assert [link["id"] for link in await listed(soo, spacecraft_id="yamal-300")] == ["other"]
    assert (await soo.client.delete(f"{LINKS}/other")).status_code == 204
    assert [link["id"] for link in await listed(soo)] == ["none", "sa-1"]


async def test_rows_missing_stand_with_the_link_until_they_come(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)

    async def rows(first_seq: int, count: int) -> None:
        epochs = [format_epoch(NOW_US + (seq - 100) * S) for seq in range(first_seq, first_seq + count)]
        measurements = [{"epoch": epoch, "power_dbm": [None] * 4} for epoch in epochs]
        body = {"plan_id": plan_id, "source": "sa-1", "first_seq": first_seq, "measurements": measurements}
        answer = await soo.client.post("/api/v1/spacecraft/yamal-202/measurements:batch", json=body)
        assert answer.json()["accepted"] == count

    await rows(1, 10)
    await rows(21, 5)
    await send(soo, report(), report("unknown", spacecraft_id="not-there"), report("no-source", source=None))
    reported = {link["id"]: link["rows_missing"] for link in await listed(soo)}
    assert reported == {"sa-1": 10, "unknown": None, "no-source": None}
    await rows(11, 10)
    assert (await soo.client.get(f"{LINKS}/sa-1")).json()["rows_missing"] == 0


@pytest.mark.parametrize("name", ["nobody", "%00", "a%20b", "x" * 500])
async def test_unknown_links_are_404(soo, name):
    for method, path in (("POST", f"{name}:enable"), ("POST", f"{name}:reset"), ("DELETE", name), ("GET", name)):
        answer = await soo.client.request(method, f"{LINKS}/{path}")
        assert (answer.status_code, answer.json()["code"]) == (404, "link.unknown")


MANY = dict.fromkeys(map(str, range(129)), 1)
BAD = [
    ("no links", {"links": []}, "value.length", "/links"),
    ("too many", {"links": [report(f"l{k}") for k in range(65)]}, "value.length", "/links"),
    ("twice", {"links": [report(), report()]}, "link.duplicate", ""),
    ("unknown field", {"links": [report(colour="red")]}, "field.unknown", "/links/0/colour"),
    ("id with a slash", {"links": [report("a/b")]}, "value.pattern", "/links/0/id"),
    ("id too long", {"links": [report("a" * 65)]}, "value.pattern", "/links/0/id"),
    ("kind", {"links": [report(kind="modem")]}, "value.choice", "/links/0/kind"),
    ("counter fraction", {"links": [report(counters={"a": 1.5})]}, "value.type", "/links/0/counters/a"),
    ("counter negative", {"links": [report(counters={"a": -1})]}, "value.range", "/links/0/counters/a"),
    ("counters many", {"links": [report(counters=MANY)]}, "value.length", "/links/0/counters"),
    ("detail large", {"links": [report(detail={"a": "x" * 8200})]}, "value.length", "/links/0/detail"),
    ("detail no object", {"links": [report(detail=[])]}, "value.type", "/links/0/detail"),
    ("last_good", {"links": [report(last_good="now")]}, "epoch.malformed", "/links/0/last_good"),
    ("warning", {"links": [report(warnings=[{"code": "a b"}])]}, "value.pattern", "/links/0/warnings/0/code"),
    ("period", {"links": [report(period_s=0)]}, "value.range", "/links/0/period_s"),
]  # fmt: skip


@pytest.mark.parametrize(("body", "code", "pointer"), [c[1:] for c in BAD], ids=[c[0] for c in BAD])
async def test_bad_reports_are_refused_whole(soo, body, code, pointer):
    answer = await soo.client.post(REPORT, json=body)
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (422, code), problem
    assert problem["errors"][0]["pointer"] == pointer
    assert soo.storage.links.links() == ()


async def test_numbers_that_are_none_are_refused_in_the_detail_too(soo):
    text = json.dumps({"links": [report(detail={"deep": [{"x": "@"}]})]}).replace('"@"', "NaN")
    answer = await soo.client.post(REPORT, content=text)
    assert (answer.status_code, answer.json()["code"]) == (422, "value.not_finite")


async def test_whatever_an_analyzer_answered_may_be_told(soo):
    odd = "\u0000*IDN?\x7f\ufffd\n"
    await send(soo, report(warnings=[{"code": "analyzer.fault", "detail": odd}], detail={"last": odd}))
    (reported,) = await listed(soo)
    assert (reported["warnings"][0]["detail"], reported["detail"]["last"]) == (odd, odd)


async def test_a_bad_filter_is_a_422(soo):
    answer = await soo.client.get(LINKS, params={"spacecraft_id": "A B"})
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, "/query/spacecraft_id")


URL = "/api/v1/spacecraft/yamal-202/traces"


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


async def trace_send(soo, *traces: dict[str, Any], source: str = "sa-1") -> dict[str, Any]:
    answer = await soo.client.post(URL, json={"source": source, "traces": list(traces)})
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


@pytest.fixture
async def record(soo, spacecraft, carriers):
    await soo.with_plan(spacecraft, carriers)
    return soo


async def test_a_trace_is_kept_once_listed_and_read(record):
    assert await trace_send(record, trace(-2)) == {
        "received": 1,
        "accepted": 1,
        "duplicates": 0,
        "dropped": 0,
        "refused": [],
    }
    assert (await trace_send(record, trace(-2), trace(-1)))["duplicates"] == 1
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
    await trace_send(record, trace(-2))
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
    await trace_send(record, *(trace(-k) for k in range(5, 0, -1)))
    await trace_send(record, trace(-3, sweep="tp2"), source="sa-2")
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
    receipt = await trace_send(record, trace(-1), trace(6), trace(epoch="1999-12-31T23:59:59.000000Z"))
    assert (receipt["received"], receipt["accepted"]) == (3, 1)
    assert [(r["index"], r["code"]) for r in receipt["refused"]] == [(1, "time.future"), (2, "time.too_old")]
    assert all(r["next_step"] == NEXT_STEPS[r["code"]] for r in receipt["refused"])
    record.clock.data["yamal-202"] = None
    # nothing has moved the data clock yet: the end of the calendar is the bound
    late = await trace_send(record, trace(50 * 365 * 86_400), trace(epoch="2101-01-01T00:00:00.000000Z"))
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


POWER = "/traces/0/power_dbm"
TRACE_BAD = [
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


@pytest.mark.parametrize(("body", "code", "pointer"), [c[1:] for c in TRACE_BAD], ids=[c[0] for c in TRACE_BAD])
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
