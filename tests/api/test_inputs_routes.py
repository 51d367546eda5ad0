"""References, corrections, telemetry: batches in, pages out."""

import pytest

from service.api.problems.next_steps import NEXT_STEPS

pytestmark = pytest.mark.anyio
SC = "/api/v1/spacecraft"
BASE = f"{SC}/yamal-202"
T0 = "2026-11-20T00:00:00.000000Z"
T1 = "2026-11-20T00:10:00.000000Z"
T2 = "2026-11-20T00:20:00.000000Z"


async def test_references_are_stored_counted_and_listed(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    soo.accepted.clear()
    full = {"epoch": T0, "yaw_deg": 0.1, "roll_deg": 0.02, "pitch_deg": -0.01, "sigma_deg": {"yaw": 0.01, "roll": 0.03}}
    body = {"source": "star_tracker", "references": [full, {"epoch": T1, "roll_deg": 0.05}]}
    answer = await soo.client.post(f"{BASE}/attitude-references:batch", json=body)
    assert (answer.status_code, answer.json()) == (200, {"received": 2, "accepted": 2, "duplicates": 0, "refused": []})
    assert soo.accepted == ["yamal-202"]
    body["references"].append({"epoch": T2, "yaw_deg": 181})
    body["references"][1]["roll_deg"] = 0.06
    again = (await soo.client.post(f"{BASE}/attitude-references:batch", json=body)).json()
    assert (again["received"], again["accepted"], again["duplicates"]) == (3, 0, 1)
    assert [(r["index"], r["code"]) for r in again["refused"]] == [(1, "input.conflict"), (2, "value.out_of_range")]
    listed = (await soo.client.get(f"{BASE}/attitude-references")).json()
    assert listed == {
        "range": {"start": "2000-01-01T00:00:00.000000Z", "stop": "2100-01-01T00:00:00.000000Z"},
        "rows": [
            full | {"source": "star_tracker", "sigma_deg": {"yaw": 0.01, "roll": 0.03, "pitch": None}},
            {
                "source": "star_tracker",
                "epoch": T1,
                "yaw_deg": None,
                "roll_deg": 0.05,
                "pitch_deg": None,
                "sigma_deg": {"yaw": None, "roll": None, "pitch": None},
            },
        ],
        "next": None,
    }


async def test_indices_of_refused_rows_are_those_of_the_request(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    rows = [{"epoch": T0, "yaw_deg": 1.0}, {"epoch": T1}, {"epoch": T0, "yaw_deg": 2.0}, {"epoch": T2, "yaw_deg": 1.0}]
    answer = await soo.client.post(f"{BASE}/attitude-references:batch", json={"source": "other", "references": rows})
    assert [(r["index"], r["code"]) for r in answer.json()["refused"]] == [(1, "value.absent"), (2, "input.conflict")]
    assert [r["next_step"] for r in answer.json()["refused"]] == ["Leave the row out.", NEXT_STEPS["input.conflict"]]
    assert answer.json()["accepted"] == 2


async def test_corrections_and_telemetry_read_back_as_sent(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    correction = {"start": T0, "stop": T1, "yaw_deg": 0.0, "roll_deg": -0.2, "pitch_deg": 0.0}
    sent = {"start": T0, "stop": T1, "roll_deg": -0.2}
    assert (await soo.client.post(f"{BASE}/corrections:batch", json={"corrections": [sent]})).json()["accepted"] == 1
    assert (await soo.client.get(f"{BASE}/corrections")).json()["rows"] == [correction]
    record = {
        "epoch": T0,
        "onboard_mode": "forecast",
        "wheel_momentum_n_m_s": [1.0, -2.5, 0.0],
        "wheel_speed_rpm": None,
        "thrusters_active": False,
        "body_rate_deg_s": {"yaw": 1e-4, "roll": None, "pitch": 0.0},
    }
    assert (await soo.client.post(f"{BASE}/telemetry:batch", json={"records": [record]})).json()["accepted"] == 1
    assert (await soo.client.get(f"{BASE}/telemetry")).json()["rows"] == [record]


async def test_pages_follow_one_another_without_loss_or_repetition(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    epochs = [f"2026-11-20T00:00:{k:02d}.000000Z" for k in range(7)]
    rows = [{"epoch": epoch, "roll_deg": 0.1} for epoch in epochs]
    for source in ("star_tracker", "earth_sensor"):
        await soo.client.post(f"{BASE}/attitude-references:batch", json={"source": source, "references": rows[::-1]})
    seen, url, pages = [], f"{BASE}/attitude-references?limit=4&start={epochs[0]}&stop={epochs[6]}", 0
    while url:
        answer = await soo.client.get(url)
        page = answer.json()
        seen += [(row["epoch"], row["source"]) for row in page["rows"]]
        assert page["range"] == {"start": epochs[0], "stop": epochs[6]}
        assert (page["next"] is None) == ("link" not in answer.headers)
        url = answer.headers["link"].removeprefix("<").removesuffix('>; rel="next"') if page["next"] else None
        pages += 1
    assert pages == 3
    assert [epoch for epoch, _ in seen] == sorted(epochs[:6] * 2), "start is inclusive, stop exclusive"
    assert len(set(seen)) == 12


async def test_pages_from_the_end_are_those_from_the_start_turned_round(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    rows = [{"epoch": f"2026-11-20T00:00:{k:02d}.000000Z", "roll_deg": 0.1} for k in range(5)]
    for source in ("star_tracker", "earth_sensor"):
        await soo.client.post(f"{BASE}/attitude-references:batch", json={"source": source, "references": rows})
    url, seen = f"{BASE}/attitude-references?limit=3&order=desc", []
    while url:
        answer = await soo.client.get(url)
        seen += answer.json()["rows"]
        link = answer.headers.get("link")
        url = link and link.removeprefix("<").removesuffix('>; rel="next"')
    assert seen[::-1] == (await soo.client.get(f"{BASE}/attitude-references")).json()["rows"]
    cursor = (await soo.client.get(f"{BASE}/attitude-references?limit=3&order=desc")).json()["next"]
    other = await soo.client.get(f"{BASE}/attitude-references?limit=3&cursor={cursor}")
    assert (other.status_code, other.json()["code"]) == (422, "cursor.invalid")


async def test_a_correction_that_overlaps_the_range_is_listed(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    await soo.client.post(f"{BASE}/corrections:batch", json={"corrections": [{"start": T0, "stop": T2, "yaw_deg": 1}]})
    for start, stop, count in ((T1, T2, 1), (T2, "2026-11-21T00:00:00Z", 0)):
        rows = (await soo.client.get(f"{BASE}/corrections", params={"start": start, "stop": stop})).json()["rows"]
        assert len(rows) == count


@pytest.mark.parametrize(
    ("path", "key", "row", "code"),
    [
        ("attitude-references", "references", {"epoch": T0}, "value.absent"),
        ("attitude-references", "references", {"epoch": T0, "yaw_deg": -180.1}, "value.out_of_range"),
        (
            "attitude-references",
            "references",
            {"epoch": T0, "yaw_deg": 1, "sigma_deg": {"yaw": 0}},
            "value.out_of_range",
        ),
        ("attitude-references", "references", {"epoch": "1999-12-31T00:00:00Z", "yaw_deg": 1}, "time.too_old"),
        ("attitude-references", "references", {"epoch": "9999-12-31T00:00:00Z", "yaw_deg": 1}, "time.future"),
        ("corrections", "corrections", {"start": T1, "stop": T0, "yaw_deg": 1}, "range.invalid"),
        ("corrections", "corrections", {"start": T0, "stop": T0, "yaw_deg": 1}, "range.invalid"),
        ("corrections", "corrections", {"start": T0, "stop": T1}, "value.absent"),
        ("corrections", "corrections", {"start": "0001-01-01T00:00:00Z", "stop": T1, "yaw_deg": 1}, "time.too_old"),
        ("telemetry", "records", {"epoch": T0}, "value.absent"),
        ("telemetry", "records", {"epoch": "9999-12-31T23:59:59Z", "onboard_mode": "x"}, "time.future"),
    ],
)
async def test_rows_that_cannot_be_are_left_out(soo, spacecraft, path, key, row, code):
    await soo.client.post(SC, json=spacecraft)
    soo.accepted.clear()
    more = {"source": "other"} if path == "attitude-references" else {}
    answer = await soo.client.post(f"{BASE}/{path}:batch", json={key: [row]} | more)
    assert answer.status_code == 200
    assert [(r["index"], r["code"]) for r in answer.json()["refused"]] == [(0, code)]
    assert (await soo.client.get(f"{BASE}/{path}")).json()["rows"] == []
    assert soo.accepted == []


ROW = '{"epoch":"2026-11-20T00:00:00Z","yaw_deg":1}'
BAD = [
    ("attitude-references", "", 400, "json.malformed"),
    ("attitude-references", "[]", 422, "value.type"),
    ("attitude-references", '{"references":[]}', 422, "field.missing"),
    ("attitude-references", '{"source":"gyro","references":[]}', 422, "value.choice"),
    ("attitude-references", '{"source":"other","references":{}}', 422, "value.type"),
    ("attitude-references", '{"source":"other","references":[{"yaw_deg":1}]}', 422, "field.missing"),
    ("attitude-references", '{"source":"other","references":[{"epoch":"now"}]}', 422, "epoch.malformed"),
    ("attitude-references", '{"source":"other","references":[{"epoch":null}]}', 422, "epoch.malformed"),
    ("attitude-references", '{"source":"other","references":[],"x":1}', 422, "field.unknown"),
    (
        "attitude-references",
        ROW.join(['{"source":"other","references":[', "]}"]).replace(":1}", ":NaN}"),
        422,
        "value.not_finite",
    ),
    (
        "attitude-references",
        ROW.join(['{"source":"other","references":[', "]}"]).replace(":1}", ':"1"}'),
        422,
        "value.type",
    ),
    ("attitude-references", '{"source":"other","references":[' + ",".join([ROW] * 201) + "]}", 422, "batch.too_long"),
    ("corrections", "{}", 422, "field.missing"),
    ("corrections", '{"corrections":[{"start":"2026-11-20T00:00:00Z"}]}', 422, "field.missing"),
    ("corrections", '{"corrections":[3]}', 422, "value.type"),
    ("telemetry", '{"records":[{"epoch":"2026-11-20T00:00:00Z","thrusters_active":1}]}', 422, "value.type"),
    ("telemetry", '{"records":[{"epoch":"2026-11-20T00:00:00Z","wheel_speed_rpm":[]}]}', 422, "value.length"),
    ("telemetry", '{"records":[{"epoch":"2026-11-20T00:00:00Z","wheel_speed_rpm":[1e300]}]}', 422, "value.range"),
    ("telemetry", '{"records":[{"epoch":"2026-11-20T00:00:00Z","onboard_mode":"a\\u0000"}]}', 422, "value.pattern"),
]


@pytest.mark.parametrize(("path", "body", "status", "code"), BAD)
async def test_bad_batches_are_refused_whole(soo, spacecraft, path, body, status, code):
    await soo.client.post(SC, json=spacecraft)
    soo.accepted.clear()
    answer = await soo.client.post(f"{BASE}/{path}:batch", content=body)
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (status, code), problem
    assert answer.headers["content-type"] == "application/problem+json"
    assert (await soo.client.get(f"{BASE}/{path}")).json()["rows"] == []
    assert soo.accepted == []


@pytest.mark.parametrize("path", ["attitude-references", "corrections", "telemetry", "operations"])
@pytest.mark.parametrize(
    ("query", "code", "pointer"),
    [
        ("limit=0", "value.range", "/query/limit"),
        ("limit=10001", "value.range", "/query/limit"),
        ("limit=ten", "value.type", "/query/limit"),
        ("start=yesterday", "epoch.malformed", "/query/start"),
        ("stop=2026-11-21", "epoch.malformed", "/query/stop"),
        ("start=2026-11-21T00:00:00Z&stop=2026-11-21T00:00:00Z", "range.invalid", "/query/start"),
        ("start=2026-11-22T00:00:00Z&stop=2026-11-21T00:00:00Z", "range.invalid", "/query/start"),
        ("order=newest", "value.choice", "/query/order"),
        ("cursor=", "cursor.invalid", "/query/cursor"),
        ("cursor=abc", "cursor.invalid", "/query/cursor"),
        ("cursor=%F0%9F%98%80", "cursor.invalid", "/query/cursor"),
        ("cursor=AgAAAAAAAAAAAAAAAAAAAAA", "cursor.invalid", "/query/cursor"),
        ("cursor=" + "A" * 100, "value.length", "/query/cursor"),
    ],
)
async def test_bad_ranges_limits_and_cursors_are_refused(soo, spacecraft, path, query, code, pointer):
    await soo.client.post(SC, json=spacecraft)
    answer = await soo.client.get(f"{BASE}/{path}?{query}")
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (422, code), problem
    assert problem["errors"][0]["pointer"] == pointer


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("attitude-references", {"source": "other", "references": []}),
        ("corrections", {"corrections": []}),
        ("telemetry", {"records": []}),
    ],
)
async def test_an_unknown_spacecraft_is_a_404(soo, path, body):
    for answer in (
        await soo.client.post(f"{BASE}/{path}:batch", json=body),
        await soo.client.get(f"{BASE}/{path}"),
    ):
        assert (answer.status_code, answer.json()["code"]) == (404, "spacecraft.unknown")
