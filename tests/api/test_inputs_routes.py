"""References, corrections, telemetry, operations, polarisation and weather: batches in, pages out."""

import pytest

from service.api.problems.next_steps import NEXT_STEPS
from service.records.epoch import format_epoch

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


async def test_a_momentum_beyond_the_catalogue_is_a_refused_row(soo, spacecraft):
    """One record of 1e6 N m s was stored, believed, and tripped control."""
    await soo.client.post(SC, json={**spacecraft, "wheels": {"momentum_limit_n_m_s": 30.0}})
    momenta = [[30.0, -30.0, 0.0], [0.0, -30.1, 0.0], None, [1e6, 0.0, 0.0]]
    records = [
        {"epoch": f"2026-11-20T00:0{k}:00Z", "onboard_mode": "n", "wheel_momentum_n_m_s": momentum}
        for k, momentum in enumerate(momenta)
    ]
    answer = (await soo.client.post(f"{BASE}/telemetry:batch", json={"records": records})).json()
    refused = [(each["index"], each["code"], each["next_step"]) for each in answer["refused"]]
    assert refused == [(k, "telemetry.momentum", NEXT_STEPS["telemetry.momentum"]) for k in (1, 3)]
    assert "30 N m s" in answer["refused"][0]["detail"]
    assert soo.app.state.context.storage.alarms.refused() == {"yamal-202": 2}
    listed = (await soo.client.get(f"{BASE}/telemetry")).json()["rows"]
    assert [row["wheel_momentum_n_m_s"] for row in listed] == [momenta[0], None]


async def test_no_epoch_of_a_simulated_spacecraft_lies_a_year_past_its_newest_row(soo, spacecraft):
    await soo.client.post(SC, json={**spacecraft, "simulated": True})
    newest_us = soo.clock.data["yamal-202"] = soo.clock.system_us()
    day_us = 86_400_000_000
    within, beyond = (format_epoch(newest_us + 366 * day_us + past_us) for past_us in (0, 1))
    batches = {
        "attitude-references": {
            "source": "other",
            "references": [{"epoch": e, "roll_deg": 1} for e in (within, beyond)],
        },
        "corrections": {"corrections": [{"start": T0, "stop": e, "roll_deg": 1} for e in (within, beyond)]},
        "telemetry": {"records": [{"epoch": e, "onboard_mode": "normal"} for e in (within, beyond)]},
    }
    for path, body in batches.items():
        answer = (await soo.client.post(f"{BASE}/{path}:batch", json=body)).json()
        assert (answer["accepted"], [(r["index"], r["code"]) for r in answer["refused"]]) == (1, [(1, "time.future")])
    soo.clock.data["yamal-202"] = None
    body = {"records": [{"epoch": "2099-01-01T00:00:00Z", "onboard_mode": "normal"}]}
    assert (await soo.client.post(f"{BASE}/telemetry:batch", json=body)).json()["accepted"] == 1, "no row bounds it"


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


URL = f"{SC}/yamal-202/operations"
START = "2026-11-25T00:00:00.000000Z"
STOP = "2026-11-25T01:00:00.000000Z"
FULL = {
    "kind": "carrier_work",
    "start": START,
    "stop": STOP,
    "carriers": ["c00", "c03"],
    "transponders": ["Ku1"],
    "inhibit_control": True,
    "attitude_uncertainty_deg": {"yaw": 0.1, "roll": None, "pitch": 0.0},
    "comment": "first line\nsecond line",
}


async def test_an_operation_reads_back_as_declared(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    soo.accepted.clear()
    created = await soo.client.post(URL, json=FULL)
    assert created.status_code == 201, created.text
    assert created.json() == FULL | {"id": 1, "revision": 1}
    assert created.headers["location"] == f"{URL}/1"
    assert (await soo.client.get(created.headers["location"])).json() == created.json()
    assert (await soo.client.get(URL)).json()["rows"] == [created.json()]
    assert soo.accepted == ["yamal-202"]


@pytest.mark.parametrize(
    ("kind", "does_inhibit"),
    [("station_keeping", True), ("momentum_unloading", True), ("carrier_work", False), ("eclipse", False)],
)
async def test_kinds_that_turn_the_craft_inhibit_control_unless_it_is_said_otherwise(
    soo, spacecraft, kind, does_inhibit
):
    await soo.client.post(SC, json=spacecraft)
    plain = (await soo.client.post(URL, json={"kind": kind, "start": START})).json()
    assert (plain["inhibit_control"], plain["stop"]) == (does_inhibit, None)
    said = (await soo.client.post(URL, json={"kind": kind, "start": START, "inhibit_control": not does_inhibit})).json()
    assert said["inhibit_control"] is not does_inhibit


async def test_a_change_is_a_new_revision_and_only_the_newest_is_listed(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    await soo.client.post(URL, json=FULL)
    soo.accepted.clear()
    patch = {"stop": "2026-11-25T02:00:00.000000Z", "attitude_uncertainty_deg": {"yaw": None}, "carriers": None}
    changed = await soo.client.patch(f"{URL}/1", json=patch)
    assert changed.status_code == 200, changed.text
    assert changed.json() == FULL | {
        "id": 1,
        "revision": 2,
        "stop": "2026-11-25T02:00:00.000000Z",
        "carriers": None,
        "attitude_uncertainty_deg": {"yaw": None, "roll": None, "pitch": 0.0},
    }
    assert (await soo.client.get(URL)).json()["rows"] == [changed.json()]
    assert soo.accepted == ["yamal-202"]


OPERATION_BAD = [
    ("", 400, "json.malformed"),
    ("[]", 422, "value.type"),
    ("{}", 422, "request.invalid"),
    ({"kind": "holiday", "start": START}, 422, "value.choice"),
    ({"kind": "other"}, 422, "field.missing"),
    ({"kind": "other", "start": "soon"}, 422, "epoch.malformed"),
    ({"kind": "other", "start": "1990-01-01T00:00:00Z"}, 422, "epoch.range"),
    ({"kind": "other", "start": STOP, "stop": START}, 422, "range.invalid"),
    ({"kind": "other", "start": START, "stop": START}, 422, "range.invalid"),
    ({"kind": "other", "start": START, "carriers": "c00"}, 422, "value.type"),
    ({"kind": "other", "start": START, "carriers": ["c 0"]}, 422, "value.pattern"),
    ({"kind": "other", "start": START, "carriers": []}, 422, "value.length"),
    ({"kind": "other", "start": START, "attitude_uncertainty_deg": {"yaw": -1}}, 422, "value.range"),
    ({"kind": "other", "start": START, "attitude_uncertainty_deg": [1, 2, 3]}, 422, "value.type"),
    ({"kind": "other", "start": START, "comment": "x" * 4001}, 422, "value.length"),
    ({"kind": "other", "start": START, "comment": "\u0000"}, 422, "value.pattern"),
    ({"kind": "other", "start": START, "inhibit_control": "yes"}, 422, "value.type"),
    ({"kind": "other", "start": START, "id": 5}, 422, "field.unknown"),
]


@pytest.mark.parametrize(("body", "status", "code"), OPERATION_BAD)
async def test_bad_operations_are_refused(soo, spacecraft, body, status, code):
    await soo.client.post(SC, json=spacecraft)
    soo.accepted.clear()
    sent = {"content": body} if isinstance(body, str) else {"json": body}
    answer = await soo.client.post(URL, **sent)
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    assert (await soo.client.get(URL)).json()["rows"] == []
    assert soo.accepted == []


async def test_a_bad_change_changes_nothing(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    before = (await soo.client.post(URL, json=FULL)).json()
    for patch, code in (
        ({"stop": "2026-11-24T00:00:00Z"}, "range.invalid"),
        ({"revision": 9}, "field.unknown"),
        ({"kind": None}, "field.missing"),
    ):
        answer = await soo.client.patch(f"{URL}/1", json=patch)
        assert (answer.status_code, answer.json()["code"]) == (422, code)
    assert (await soo.client.get(f"{URL}/1")).json() == before


async def test_unknown_operations_and_spacecraft_are_a_404(soo, spacecraft):
    assert (await soo.client.post(URL, json=FULL)).json()["code"] == "spacecraft.unknown"
    await soo.client.post(SC, json=spacecraft)
    for answer in (await soo.client.get(f"{URL}/7"), await soo.client.patch(f"{URL}/7", json={})):
        assert (answer.status_code, answer.json()["code"]) == (404, "operation.unknown")
    for text in ("0", "x", "99999999999"):
        assert (await soo.client.get(f"{URL}/{text}")).status_code == 422


STATED = {"source": "pol-1", "feed_offset_deg": 10.0, "frequency_hz": 11.2e9}
NOTHING = dict.fromkeys(
    ("ratio_db", "co_power_dbm", "feed_offset_deg", "noise_db", "angle_deg", "sigma_deg", "tec_tecu")
)


@pytest.fixture
async def now(soo, spacecraft):
    """The present as text, of a spacecraft that has a polarimeter."""
    answer = await soo.client.post(SC, json=spacecraft | {"polarimeters": [STATED]})
    assert answer.status_code == 201, answer.text
    soo.accepted.clear()
    return format_epoch(soo.clock.system_us())


async def sent(soo, *records, source="pol-1"):
    answer = await soo.client.post(f"{BASE}/polarization:batch", json={"source": source, "records": list(records)})
    assert answer.status_code == 200, answer.text
    return answer.json()


async def test_records_read_back_as_sent_and_count_once(soo, now):
    row = {"epoch": now, "ratio_db": -15.0, "co_power_dbm": -55.0, "noise_db": 0.06, "tec_tecu": 12.0}
    assert (await sent(soo, row))["accepted"] == 1
    assert soo.accepted == ["yamal-202"]
    assert (await sent(soo, row))["duplicates"] == 1
    assert [r["code"] for r in (await sent(soo, row | {"ratio_db": -14.0}))["refused"]] == ["input.conflict"]
    listed = (await soo.client.get(f"{BASE}/polarization")).json()["rows"]
    assert listed == [{"source": "pol-1"} | NOTHING | row]


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"ratio_db": None}, "value.absent"),
        ({"angle_deg": 0.1}, "value.absent"),
        ({"ratio_db": 61.0}, "value.out_of_range"),
        ({"feed_offset_deg": 0.0}, "value.out_of_range"),
        ({"feed_offset_deg": 81.0}, "value.out_of_range"),
        ({"noise_db": 0.0}, "value.out_of_range"),
        ({"tec_tecu": -1.0}, "value.out_of_range"),
        ({"epoch": "2099-01-01T00:00:00Z"}, "time.future"),
        ({"epoch": "1999-01-01T00:00:00Z"}, "time.too_old"),
    ],
)
async def test_records_that_cannot_be_are_left_out(soo, now, changes, code):
    answer = await sent(soo, {"epoch": now, "ratio_db": -15.0} | changes)
    assert [(r["index"], r["code"]) for r in answer["refused"]] == [(0, code)]
    assert (await soo.client.get(f"{BASE}/polarization")).json()["rows"] == []
    assert soo.accepted == []


async def test_an_unknown_polarimeter_is_answered_with_the_known_ones(soo, now):
    (refused,) = (await sent(soo, {"epoch": now, "ratio_db": -15.0}, source="pol-2"))["refused"]
    assert refused["code"] == "polarimeter.unknown"
    assert refused["detail"].endswith("it states: pol-1")


@pytest.mark.parametrize(
    ("polarimeters", "code"),
    [
        ([STATED | {"feed_offset_deg": 0.2}], "polarimeter.feed_offset"),
        ([STATED, STATED], "polarimeter.duplicate"),
        ([{"source": "pol-1"}], "request.invalid"),
    ],
)
async def test_polarimeters_that_measure_nothing_are_refused(soo, spacecraft, polarimeters, code):
    answer = await soo.client.post(SC, json=spacecraft | {"polarimeters": polarimeters})
    assert (answer.status_code, answer.json()["code"]) == (422, code), answer.text


async def test_a_polarimeter_reads_back_with_its_defaults(soo, now):
    (stated,) = (await soo.client.get(BASE)).json()["polarimeters"]
    assert {name: stated[name] for name in STATED} == STATED
    assert (stated["site"], stated["used"], stated["field_t"]) == (None, True, 0.0)


def report(make_epoch, **changes):
    return {"epoch": make_epoch, "station": "Station 1", "rain_rate_mm_h": 2.5} | changes


@pytest.fixture
async def weather_now(soo, spacecraft, carriers):
    """The present as text, of a spacecraft that has a carrier plan."""
    await soo.client.post(SC, json=spacecraft)
    await soo.client.put(f"{BASE}/carriers", json={"carriers": carriers})
    soo.accepted.clear()
    return format_epoch(soo.clock.system_us())


async def weather_sent(soo, *reports, source="radar"):
    answer = await soo.client.post(f"{BASE}/weather:batch", json={"source": source, "reports": list(reports)})
    assert answer.status_code == 200, answer.text
    return answer.json()


async def test_reports_read_back_as_sent_and_count_once(soo, weather_now):
    rows = [report(weather_now), report(weather_now, station="Station 0", rain_rate_mm_h=None, attenuation_db=0.0)]
    assert (await weather_sent(soo, *rows))["accepted"] == 2
    assert soo.accepted == ["yamal-202"]
    assert (await weather_sent(soo, *rows))["duplicates"] == 2
    assert (await weather_sent(soo, *rows, source="gauge"))["accepted"] == 2
    assert [r["code"] for r in (await weather_sent(soo, report(weather_now, rain_rate_mm_h=0.0)))["refused"]] == [
        "input.conflict"
    ]
    listed = (await soo.client.get(f"{BASE}/weather")).json()["rows"]
    assert listed == [{"source": source, "attenuation_db": None} | row for source in ("radar", "gauge") for row in rows]


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"station": "Station 7"}, "station.unknown"),
        ({"station": "station 1"}, "station.unknown"),
        ({"rain_rate_mm_h": None}, "value.absent"),
        ({"rain_rate_mm_h": -0.1}, "value.out_of_range"),
        ({"rain_rate_mm_h": 2001}, "value.out_of_range"),
        ({"attenuation_db": -3.0}, "value.out_of_range"),
        ({"attenuation_db": 101}, "value.out_of_range"),
        ({"epoch": "2099-01-01T00:00:00Z"}, "time.future"),
        ({"epoch": "1999-01-01T00:00:00Z"}, "time.too_old"),
    ],
)
async def test_reports_that_cannot_be_are_left_out(soo, weather_now, changes, code):
    answer = await weather_sent(soo, report(weather_now, **changes))
    assert [(r["index"], r["code"]) for r in answer["refused"]] == [(0, code)]
    assert (await soo.client.get(f"{BASE}/weather")).json()["rows"] == []
    assert soo.accepted == []


async def test_an_unknown_station_is_answered_with_the_known_ones(soo, weather_now):
    (refused,) = (await weather_sent(soo, report(weather_now, station="Statoin 1")))["refused"]
    assert refused["detail"].endswith("it has: Station 0, Station 1, Station 2")


async def test_without_a_carrier_plan_there_is_no_station(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    body = {"source": "radar", "reports": [report("2026-11-20T00:00:00Z")]}
    answer = await soo.client.post(f"{BASE}/weather:batch", json=body)
    assert (answer.status_code, answer.json()["code"]) == (404, "plan.none")


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ({"reports": []}, "field.missing"),
        ({"source": "", "reports": []}, "value.pattern"),
        ({"source": "radar", "reports": [{"epoch": "2026-11-20T00:00:00Z"}]}, "field.missing"),
        ({"source": "radar", "reports": [report("2026-11-20T00:00:00Z", rain_rate_mm_h="wet")]}, "value.type"),
        ({"source": "radar", "reports": [report("2026-11-20T00:00:00Z", rain=1)]}, "field.unknown"),
        ({"source": "radar", "reports": [report("yesterday")]}, "epoch.malformed"),
    ],
)
async def test_bad_batches_of_weather_are_refused_whole(soo, weather_now, body, code):
    answer = await soo.client.post(f"{BASE}/weather:batch", json=body)
    assert (answer.status_code, answer.json()["code"]) == (422, code), answer.text
    assert soo.accepted == []
